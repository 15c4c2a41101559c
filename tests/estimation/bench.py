"""One team's belief on the bench: states set by hand, the filter's functions run one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.agents.team import Team
from coop_envs.estimation.belief import Belief, MemberModel, allocate_belief, member_models
from coop_envs.estimation.calibration import Optics, pack_optics
from coop_envs.estimation.correction import correct_odometry, correct_rest
from coop_envs.estimation.kalman import GATE_SIX, correct_six, passes
from coop_envs.estimation.propagation import FilterModel, Transition, add_noise, integrate, propagate_covariance
from coop_envs.estimation.rows import Rows, allocate_rows
from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.sightings import compare, innovation, judge, project
from coop_envs.sensing.measurements import Measurements, allocate_measurements
from coop_envs.sensing.poses import mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

TICK_S, TICKS = 1.0 / 30.0, 6
G = np.array([0.0, 0.0, -9.81])
SIZE = 15
CAMERA = {"base": "lifecam", "position_m": [0.03, -0.01, 0.06], "pitch_down_rad": 0.3}
TEAM = load_team(
    {
        "members": [
            {"role": "observer", "robot": "zumy", "cameras": [CAMERA], "hat": "hat0"},
            {"role": "picket", "robot": "zumy", "hat": "zumy", "count": 2},
        ]
    }
)


@wp.kernel
def run_integrate(belief: Belief, measured: Measurements, model: FilterModel, r: int, out: wp.array[Transition]):
    out[0] = integrate(belief, measured, model, 0, r)


@wp.kernel
def run_spread(belief: Belief, rows: Rows, phi: wp.array[Transition], r: int):
    propagate_covariance(belief, rows, 0, belief.slot[0, r], phi[0])


@wp.kernel
def run_noise(belief: Belief, members: wp.array[MemberModel], phi: wp.array[Transition], r: int, shake: wp.float64):
    add_noise(belief, members[r], 0, belief.slot[0, r], phi[0], shake)


@wp.kernel
def run_compare(
    belief: Belief,
    measured: Measurements,
    members: wp.array[MemberModel],
    rows: Rows,
    i: int,
    j: int,
    residual: wp.array[vec6d],
    S: wp.array[mat66d],
):
    view = compare(belief, measured, members[i], 0, i, j)
    for s in range(belief.slots[0]):
        project(rows, 0, view, s)
    residual[0] = view.residual
    S[0] = innovation(rows, 0, view, measured.covariance[0, i, j])


@wp.kernel
def run_pose(
    belief: Belief,
    measured: Measurements,
    members: wp.array[MemberModel],
    optics: Optics,
    rows: Rows,
    i: int,
    j: int,
    update: int,
    done: wp.array[int],
):
    verdict = judge(belief, measured, members, optics, rows, 0, i, j, update == 1)
    done[0] = int(passes(verdict.white, GATE_SIX))
    if update == 1 and done[0] == 1:
        correct_six(belief, rows, 0, verdict.white)


@wp.kernel
def run_odometry(
    belief: Belief,
    measured: Measurements,
    members: wp.array[MemberModel],
    model: FilterModel,
    rows: Rows,
    r: int,
):
    correct_odometry(belief, measured, members[r], model, rows, 0, r)


@wp.kernel
def run_rest(
    belief: Belief,
    measured: Measurements,
    members: wp.array[MemberModel],
    model: FilterModel,
    rows: Rows,
    r: int,
):
    correct_rest(belief, measured, members[r], model, rows, 0, r)


class Bench:
    """Belief of one team, every robot in the slot of its own number, far from any special pose."""

    def __init__(self, team: Team = TEAM, seed: int = 0, settings: Mapping[str, Any] | None = None) -> None:
        self.n = len(team.members)
        self.rng = np.random.default_rng(seed)
        wanted = Estimation(**(settings or {}))
        self.members = member_models(team, wanted, "cpu")
        self.belief: Belief = allocate_belief(team, 1, "cpu", wanted)
        self.measured: Measurements = allocate_measurements(1, self.n, TICKS, "cpu")
        self.rows = allocate_rows(self.belief)
        self.optics = pack_optics(team, "cpu")
        self.model = FilterModel()
        self.model.tick_s, self.model.decision_s = TICK_S, TICK_S * TICKS
        self.model.rest_s, self.model.odometry_scale = 0.3, 1.0
        first = self.belief.calibration.shape[1]
        self.belief.slot.assign(first + np.arange(self.n, dtype=np.int32)[None])
        self.belief.slots.fill_(first + self.n)
        self.measured.heard.fill_(1)
        draw = self.rng.normal
        self.set("rotation", Rotation.from_euler("zyx", draw(size=(self.n, 3)) * [1.0, 0.2, 0.2]).as_matrix())
        self.set("position", draw(size=(self.n, 3)) * [1.0, 1.0, 0.1] + np.arange(self.n)[:, None] * [0.8, 0, 0])
        self.set("velocity", draw(size=(self.n, 3)) * 0.2)
        self.set("gyro_bias", draw(size=(self.n, 3)) * 2e-3)
        self.set("accel_bias", draw(size=(self.n, 3)) * 2e-2)
        self.P = self.random_covariance()

    def random_covariance(self) -> np.ndarray:
        """Dense, correlated across robots, scaled as the filter's own."""
        scale = np.tile(np.repeat([0.02, 0.03, 0.05, 1e-3, 1e-2], 3), self.n)
        A = self.rng.normal(size=(SIZE * self.n, SIZE * self.n)) / np.sqrt(SIZE * self.n)
        P = scale[:, None] * (A @ A.T + 0.1 * np.eye(len(A))) * scale
        return 0.5 * (P + P.T)

    def get(self, name: str) -> np.ndarray:
        return getattr(self.belief, name).numpy()[0].copy()

    def set(self, name: str, value: np.ndarray) -> None:
        if name in ("position", "velocity"):
            self.set(f"first_{name}", value)
        target = getattr(self.belief, name)
        target.assign(np.asarray(value)[None].astype(target.numpy().dtype))

    @property
    def P(self) -> np.ndarray:
        return self.get("covariance")[: SIZE * self.n, : SIZE * self.n]

    @P.setter
    def P(self, value: np.ndarray) -> None:
        full = np.zeros(self.belief.covariance.shape[1:])
        full[: len(value), : len(value)] = value
        self.set("covariance", full)

    def state(self) -> dict[str, np.ndarray]:
        return {name: self.get(name) for name in ("rotation", "position", "velocity", "gyro_bias", "accel_bias")}

    def put(self, state: dict[str, np.ndarray]) -> None:
        for name, value in state.items():
            self.set(name, value)

    def run(self, kernel: wp.Kernel, *inputs: object) -> None:
        wp.launch(kernel, 1, inputs=list(inputs), device="cpu")

    def imu(self, gyro: np.ndarray, accel: np.ndarray) -> None:
        """Samples (T, 3), the same for all robots."""
        self.measured.gyro.assign(np.broadcast_to(gyro, (1, self.n, TICKS, 3)).astype(np.float32))
        self.measured.accel.assign(np.broadcast_to(accel, (1, self.n, TICKS, 3)).astype(np.float32))

    def sighting(self, i: int, j: int, R: np.ndarray, p: np.ndarray, covariance: np.ndarray) -> None:
        """A pose of robot j from camera i."""
        for name, value in (("R_camera_body", R), ("p_camera_body", p), ("covariance", covariance), ("seen", 1)):
            array = getattr(self.measured, name).numpy()
            array[0, i, j] = value


def perturbed(state: dict[str, np.ndarray], error: np.ndarray) -> dict[str, np.ndarray]:
    """The state moved by an error (15 n,): R = Exp(theta) R_hat, all else added."""
    e = error.reshape(-1, 5, 3)
    return {
        "rotation": Rotation.from_rotvec(e[:, 0]).as_matrix() @ state["rotation"],
        "position": state["position"] + e[:, 1],
        "velocity": state["velocity"] + e[:, 2],
        "gyro_bias": state["gyro_bias"] + e[:, 3],
        "accel_bias": state["accel_bias"] + e[:, 4],
    }


def difference(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> np.ndarray:
    """The error (15 n,) that moves b to a."""
    theta = Rotation.from_matrix(a["rotation"] @ np.swapaxes(b["rotation"], -1, -2)).as_rotvec()
    names = ("position", "velocity", "gyro_bias", "accel_bias")
    return np.stack([theta, *(a[name] - b[name] for name in names)], axis=1).ravel()


def numeric_jacobian(function, size: int, step: float = 1e-5) -> np.ndarray:
    """Central differences of ``function(error) -> vector`` at zero."""
    columns = [(function(step * unit) - function(-step * unit)) / (2 * step) for unit in np.eye(size)]
    return np.stack(columns, axis=1)


def camera_view(state: dict[str, np.ndarray], i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
    """R_camera_body and p_camera_body of robot j from robot i's camera, by homogeneous transforms alone.

    The optical axis is body x turned down by the camera's pitch, the image's x axis points to the right.
    """
    pitch, position = CAMERA["pitch_down_rad"], CAMERA["position_m"]
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T_body_camera = transform(Rotation.from_rotvec([0.0, pitch, 0.0]).as_matrix() @ level, position)
    T_world_i = transform(state["rotation"][i], state["position"][i])
    T_world_j = transform(state["rotation"][j], state["position"][j])
    T = np.linalg.inv(T_world_i @ T_body_camera) @ T_world_j
    return T[:3, :3], T[:3, 3]


def transform(R: np.ndarray, p) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T
