"""One module for each table and figure of the thesis: ``run(config) -> table``, ``plot(table) -> Figure``."""
