"""`Driver`: a person at the keyboard, as the runner asks for one."""

from __future__ import annotations

from collections.abc import Sequence

from coop_envs.agents.team import Member
from hardware_bridge.keyboard import Keyboard
from hardware_bridge.manual_drive import ManualSettings, ManualState, manual_step, untouched
from hardware_bridge.tick_inputs import HumanInput, KeyEvent


class Driver:
    """Reads an open keyboard and turns its keys into a person's commands.

    ``quit`` becomes true when the person wants to end; ``state`` is for displays.
    """

    def __init__(self, keyboard: Keyboard, members: Sequence[Member], settings: ManualSettings | None = None) -> None:
        self._keyboard, self._members = keyboard, members
        self._settings = settings or ManualSettings()
        self.state: ManualState = untouched(members, self._settings)
        self.quit = False

    def read(self, now_s: float) -> tuple[tuple[KeyEvent, ...], HumanInput]:
        """The keys since the last call, and what the person wants now."""
        keys = tuple(KeyEvent(now_s, key) for key in self._keyboard.read())
        self.quit = self.quit or any(event.key in ("q", "quit", "hangup") for event in keys)
        self.state, human = manual_step(self._members, self._settings, self.state, keys, now_s)
        return keys, human
