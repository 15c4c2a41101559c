"""Links: one module for each way to reach a robot."""
