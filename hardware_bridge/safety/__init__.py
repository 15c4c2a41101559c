"""The supervisor: what stands between every policy or person and the robots."""

from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.situation import Intervention, RobotSituation, Situation
from hardware_bridge.safety.supervisor import Supervisor, stopped_commands
from hardware_bridge.safety.watchdog import Watchdog, WatchdogTrip

__all__ = [
    "Intervention",
    "RobotSituation",
    "SafetyLimits",
    "Situation",
    "Supervisor",
    "Watchdog",
    "WatchdogTrip",
    "stopped_commands",
]
