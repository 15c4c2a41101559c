"""What can go wrong by a user's hand, told in one line."""


class CoopError(Exception):
    """Base of every error a user can cause."""


class ConfigError(CoopError):
    """A field holds a value that cannot be used.

    The message is one line: ``field: got value, expected what``.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        self.field, self.value, self.expected = field, value, expected
        text = " ".join(repr(value).split())
        if len(text) > 120:
            text = text[:117] + "..."
        super().__init__(f"{field}: got {text}, expected {expected}")


class WorldError(ConfigError):
    """A world that robots cannot be placed in: broken mesh, no free ground, a start in a wall."""


class ActionError(ConfigError):
    """An action of the wrong shape, or not finite."""


def require(condition: bool, field: str, value: object, expected: str) -> None:
    """Raise `ConfigError` naming field, value and expectation unless the condition holds."""
    if not condition:
        raise ConfigError(field, value, expected)
