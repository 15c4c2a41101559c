"""From recorded or live measurements to beliefs, observations and commands, without the simulator.

Imports sensing, estimation, mapping, observations and actions only: what runs here runs on a robot's host.
"""
