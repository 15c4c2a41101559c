"""`Mission`: from raw inputs to supervised commands, tick by tick; a function of what it is fed, so it can be replayed.

The loop of a decision is: inputs -> measurements -> belief -> observations -> policy -> commands -> supervisor. It
holds no port and reads no clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.actions import ACTION_SIZE, checked_action
from coop_envs.agents.command import allocate_command
from coop_envs.agents.control import control, drive_models
from coop_envs.agents.raster import Raster, laser_models
from coop_envs.belief_loop import BeliefLoop
from coop_envs.errors import ActionError
from coop_envs.estimation.belief import Declared
from coop_envs.geometry.arrays import allocate
from coop_envs.inchworm_rule import may_move, wants_to_move
from coop_envs.observations import by_agent, observation_arrays
from coop_envs.policy import Policy, check_needs
from coop_envs.sensing.measurements import allocate_measurements
from hardware_bridge.command import RobotCommand, SafeCommand
from hardware_bridge.deployment import Deployment
from hardware_bridge.safety.situation import Intervention, RobotSituation, Situation
from hardware_bridge.safety.supervisor import Supervisor
from hardware_bridge.sensing_window import SensingWindow
from hardware_bridge.tick_inputs import TickInputs

DEVICE = "cpu"
HOLD = 0
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Outcome:
    """What a tick came to.

    ``wanted`` are the policy's commands, ``safe`` what the supervisor made of them and of a person's. ``decided``: a
    decision was made in this tick. ``undock`` and ``collect`` ask people to put a reserve down at the dock and to take
    a lost robot away. ``events`` are things to tell in one line each; ``ended`` says why the mission is over, if it is.
    """

    wanted: tuple[RobotCommand, ...]
    safe: tuple[SafeCommand, ...]
    interventions: tuple[Intervention, ...]
    decided: bool
    undock: tuple[int, ...] = ()
    collect: tuple[int, ...] = ()
    events: tuple[str, ...] = ()
    ended: str | None = None


class Mission:
    """One team on its way.

    Args:
        deployment: with a site.
        policy: None where only a person drives.
        seed: of the policy.

    Raises:
        ConfigError: the policy does not fit the team.
    """

    def __init__(self, deployment: Deployment, policy: Policy | None, seed: int) -> None:
        team, rates = deployment.team, deployment.rates
        description = deployment.description()
        if policy is not None:
            check_needs(policy, description)
            policy.reset(description, seed)
        self.deployment, self.policy = deployment, policy
        self.names = description.names
        n, ticks = len(self.names), rates.ticks_per_decision
        self.measurements = allocate_measurements(1, n, ticks, DEVICE)
        self.command = allocate_command(1, n, ticks, DEVICE)
        running = wp.ones(1, dtype=int, device=DEVICE)
        self.loop = BeliefLoop(deployment.belief_settings(), self.measurements, self.command, running, DEVICE)
        self.loop.reset(np.ones(1, dtype=np.int32), deployment.plan())
        self.belief = self.loop.belief
        self._views = {key: array[0] for key, array in observation_arrays(self.loop.observations).items()}
        self._actions = wp.zeros((1, n, ACTION_SIZE), dtype=float, device=DEVICE)
        raster: Raster = allocate(Raster, (1, n), DEVICE)
        told = [self._actions, self.belief.declared, self.belief.undock, self.belief.clock]
        models = [drive_models(team, deployment.collects_lost, DEVICE), laser_models(team, rates.tick_s, DEVICE)]
        self._control = wp.launch(
            control, (1, n), inputs=[*told, *models, raster, self.command, running], device=DEVICE, record_cmd=True
        )
        self.window = SensingWindow(team, deployment.seeing, self.measurements, DEVICE)
        self._supervisor = Supervisor(deployment.safety, team)
        self._docked = [member.reserve for member in team.members]
        self._permitted: Flags = np.zeros(n, dtype=bool)
        self._sent: list[Sequence[RobotCommand]] = []
        self._tick = 0
        self._edges: list[float] = []
        self._decided_s = -np.inf
        self._act_at_rest()

    def tick(self, inputs: TickInputs) -> Outcome:
        """What to tell the robots now; then `note_sent` what they were really told."""
        ticks = self.deployment.rates.ticks_per_decision
        self.window.take(inputs)
        self._edges.append(inputs.time_s)
        decided = self._tick > 0 and self._tick % ticks == 0
        undock, collect, events = self._decide(inputs) if decided else ((), (), ())
        if self._tick == 0:
            self._decided_s = inputs.time_s
        wanted = self._wanted(self._tick % ticks)
        self._tick += 1
        safe, interventions = self._supervisor.release(inputs.time_s, wanted, self._situation(inputs))
        return Outcome(wanted, safe, interventions, decided, undock, collect, events, self._ended())

    def note_sent(self, sent: Sequence[RobotCommand]) -> None:
        """Take in what the links really sent in this tick."""
        self._sent.append(sent)

    def _decide(self, inputs: TickInputs) -> tuple[tuple[int, ...], tuple[int, ...], tuple[str, ...]]:
        self._tell_sent()
        start_s, *edges_s = self._edges
        lit = [command.brightness for command in self._sent[-1]]
        self.window.close(start_s, np.array(edges_s), lit, self._docked)
        self._edges, self._sent = [inputs.time_s], []
        self.loop.step()
        events = self._act(inputs)
        self._control.launch()
        undock, collect = (getattr(self.command, name).numpy()[0].astype(bool) for name in ("undock", "collect"))
        called = tuple(int(r) for r in np.flatnonzero(undock) if self._docked[r])
        for r in called:
            self._docked[r] = False
        lost = tuple(int(r) for r in np.flatnonzero(collect))
        return called, lost, events

    def _tell_sent(self) -> None:
        """Put what was really sent in the last decision in place of what was wanted."""
        sent, command = self._sent, self.command
        for i in range(len(self.names)):
            own = [commands[i] for commands in sent]
            command.wheels.numpy()[0, i] = np.mean([c.wheels_rad_s for c in own], axis=0)
            command.hold.numpy()[0, i] = int(all(c.stands for c in own))
            command.brightness.numpy()[0, i] = own[-1].brightness
            command.laser.numpy()[0, i] = [c.laser for c in own]
            command.galvo.numpy()[0, i] = [c.galvo for c in own]

    def _act(self, inputs: TickInputs) -> tuple[str, ...]:
        """Ask the policy; a policy that fails lets everybody stand, and its age grows until it answers again."""
        actions = np.zeros((len(self.names), ACTION_SIZE), dtype=np.float32)
        actions[:, HOLD] = 1.0
        events: tuple[str, ...] = ()
        alive = self.alive
        if self.policy is None:
            self._decided_s = inputs.time_s
        else:
            places = {name: i for i, name in enumerate(self.names) if alive[i]}
            try:
                answers = self.policy.act(by_agent(self._views, places))
                for name, i in places.items():
                    if name not in answers:
                        raise ActionError(f"action[{name}]", None, f"{ACTION_SIZE} numbers: the robot is at work")
                    actions[i] = checked_action(name, answers[name])
                self._decided_s = inputs.time_s
            except Exception as error:  # noqa: BLE001  whatever a policy does, its robots must stop
                actions[:] = 0.0
                actions[:, HOLD] = 1.0
                events = (f"policy {self.policy.name}: {type(error).__name__}: {error}",)
        self._actions.numpy()[0] = actions
        self._permitted = self._may_move(inputs, actions, alive)
        return events

    def _may_move(self, inputs: TickInputs, actions: NDArray[np.float32], alive: Flags) -> Flags:
        """Whom the inchworm rule lets move, those that a person drives included."""
        wishes = actions.copy()
        if inputs.human is not None:
            for i, command in enumerate(inputs.human.commands):
                if command is not None:
                    wishes[i, HOLD] = 1.0 if command.stands else -1.0
        arrays = {name: self._views[name] for name in ("self", "mates", "mask")} | {"alive": alive.astype(np.int8)}
        return np.asarray(may_move(arrays, wishes) | ~wants_to_move(arrays, wishes))

    def _act_at_rest(self) -> None:
        """Before the first decision everybody stands, hats half lit."""
        self._actions.numpy()[0, :, HOLD] = 1.0
        self._control.launch()

    def _wanted(self, t: int) -> tuple[RobotCommand, ...]:
        command = self.command
        return tuple(
            RobotCommand(
                (float(command.wheels.numpy()[0, i, 0]), float(command.wheels.numpy()[0, i, 1])),
                float(command.brightness.numpy()[0, i]),
                float(command.laser.numpy()[0, i, t]),
                (int(command.galvo.numpy()[0, i, t, 0]), int(command.galvo.numpy()[0, i, t, 1])),
            )
            for i in range(len(self.names))
        )

    @property
    def alive(self) -> Flags:
        """Who (N,) is not declared lost."""
        return np.asarray(self.belief.declared.numpy()[0] != int(Declared.LOST))

    def _situation(self, inputs: TickInputs) -> Situation:
        belief, now_s, human = self.belief, inputs.time_s, inputs.human
        position, rotation = belief.position.numpy()[0], belief.rotation.numpy()[0]
        covariance = belief.pose_covariance.numpy()[0, :, 3:5, 3:5]
        sigma_m = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0.0))
        yaw_rad = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
        stationary, declared = belief.stationary.numpy()[0], belief.declared.numpy()[0]
        robots = tuple(
            RobotSituation(
                position_m=(float(position[i, 0]), float(position[i, 1])),
                yaw_rad=float(yaw_rad[i]),
                sigma_m=float(sigma_m[i]),
                sample_age_s=self.window.sample_age_s(i, now_s),
                pose_age_s=self.window.frame_age_s(now_s),
                battery=self.window.battery(i),
                stationary=bool(stationary[i]),
                at_work=bool(declared[i] == int(Declared.ACTIVE)),
                docked=self._docked[i],
                permitted=bool(self._permitted[i]),
            )
            for i in range(len(self.names))
        )
        return Situation(
            robots,
            policy_age_s=now_s - self._decided_s,
            estop=inputs.estop or (human is not None and human.estop),
            release_estop=inputs.release_estop or (human is not None and human.release_estop),
            human=None if human is None else human.commands,
            human_age_s=np.inf if human is None else human.age_s,
        )

    def _ended(self) -> str | None:
        members = self.deployment.team.members
        clock = int(self.belief.clock.numpy()[0])
        if clock * self.deployment.rates.decision_s >= self.deployment.time_limit_s:
            return f"the time limit of {self.deployment.time_limit_s:g} s is over"
        if not any(alive and member.camera for alive, member in zip(self.alive, members, strict=True)):
            return "no robot with a camera is left"
        return None
