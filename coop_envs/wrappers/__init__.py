"""Wrappers around the environments: disturbances, the inchworm rule, macro-actions, randomised scenarios."""

from coop_envs.wrappers.action_delay import ActionDelay, VectorActionDelay
from coop_envs.wrappers.domain_randomisation import Choice, DomainRandomisation, Range, sample_scenario
from coop_envs.wrappers.inchworm_shield import InchwormShield, VectorInchwormShield
from coop_envs.wrappers.macro_actions import MacroActions
from coop_envs.wrappers.macro_driving import MacroSettings
from coop_envs.wrappers.message_loss import MessageLoss, VectorMessageLoss
from coop_envs.wrappers.observation_noise import NoiseSettings, ObservationNoise, VectorObservationNoise

__all__ = [
    "ActionDelay",
    "Choice",
    "DomainRandomisation",
    "InchwormShield",
    "MacroActions",
    "MacroSettings",
    "MessageLoss",
    "NoiseSettings",
    "ObservationNoise",
    "Range",
    "VectorActionDelay",
    "VectorInchwormShield",
    "VectorMessageLoss",
    "VectorObservationNoise",
    "sample_scenario",
]
