"""What a decision was worth: information against the truth, energy, losses, the goal; and who is done.

Reward is the sum of the terms named in `TERMS`. Scoring may use truth; nothing here reaches a policy but the reward.
"""

from __future__ import annotations

import warp as wp

from coop_envs.agents.team import Team
from coop_envs.estimation.belief import LOST, NO_SLOT, WORKING, Belief
from coop_envs.geometry.so3 import exp_so3, log_so3
from coop_envs.mapping.ground_map import GROUND, OBSTACLE, VOLUME, GroundMap, MapModel, change_of
from coop_envs.mapping.information import held_ubit
from coop_envs.scenario import Reward, Task
from coop_envs.sensing.poses import cholesky6, vec6d
from coop_envs.simulation.state import ACTIVE, State
from coop_envs.truth_lookup import REACHABLE, Truth, facts_at, is_fact, truth_cell

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

TERMS = ("information", "energy", "action_energy", "picket_lost", "observer_lost", "goal")
MAPPED = wp.constant(36)
SEEN_FREE = wp.constant(-24)
MICROBIT = wp.constant(1.0e-6)


@wp.struct
class ScoreModel:
    """Weights of the reward (see `scenario.Reward`) and the task: success by goal or by coverage, decisions allowed."""

    information: float
    energy: float
    action_energy: float
    picket: float
    observer: float
    goal: float
    by_coverage: int
    coverage_target: float
    decisions: int


@wp.struct
class Score:
    """Arrays over B teams (and N robots).

    terms, reward
        (B, 6) and (B,) of this decision.
    terminated, truncated, alive
        (B, N) ends of this decision, and who is left after it.
    information, mapped, reachable
        (B,) micro-bits held; cells of reachable ground that are correctly mapped, proven by a robot or seen to be free;
        cells that could be.
    covered
        (B, C) 1 for the mapped ones.
    energy, action_energy
        (B,) joules drawn by the team so far.
    prior
        (B, N) each robot's status before this decision.
    success, done
        (B,) task accomplished; nobody left.
    nees_sum, nees_count
        (B,) of the poses of robots at work, for their mean.
    """

    terms: wp.array2d[float]
    reward: wp.array[float]
    terminated: wp.array2d[int]
    truncated: wp.array2d[int]
    alive: wp.array2d[int]
    information: wp.array[wp.int64]
    mapped: wp.array[int]
    reachable: wp.array[int]
    covered: wp.array2d[wp.int8]
    energy: wp.array[wp.float64]
    action_energy: wp.array[wp.float64]
    prior: wp.array2d[int]
    success: wp.array[int]
    done: wp.array[int]
    nees_sum: wp.array[wp.float64]
    nees_count: wp.array[int]


def score_model(reward: Reward, task: Task, decision_s: float) -> ScoreModel:
    """Pack weights and task."""
    model = ScoreModel()
    model.information, model.energy = reward.information_per_bit, reward.energy_per_joule
    model.action_energy, model.goal = reward.action_energy_per_joule, reward.goal
    model.picket, model.observer = reward.loss_per_picket, reward.loss_per_observer
    model.by_coverage, model.coverage_target = int(task.success == "coverage"), task.coverage_target
    model.decisions = max(1, round(task.time_limit_s / decision_s))
    return model


def pickets(team: Team, device: str) -> wp.array:
    """1 for a picket, 2 added for a camera (N,)."""
    flags = [int(m.role == "picket") + 2 * int(m.camera is not None) for m in team.members]
    return wp.array(flags, dtype=int, device=device)


@wp.func
def pose_nees(state: State, belief: Belief, b: int, r: int) -> wp.float64:
    """Squared Mahalanobis distance of a believed pose to the truth, 6 degrees of freedom; -1 where it has none."""
    frame = state.frame[b]
    turn = exp_so3(wp.vec3d(wp.float64(0.0), wp.float64(0.0), -wp.float64(frame[3])))
    origin = wp.vec3d(wp.float64(frame[0]), wp.float64(frame[1]), wp.float64(frame[2]))
    p = turn * (wp.vec3d(state.position[b, r]) - origin) - belief.position[b, r]
    theta = log_so3(turn * wp.mat33d(state.rotation[b, r]) * wp.transpose(belief.rotation[b, r]))
    low = cholesky6(belief.pose_covariance[b, r])
    if low[0, 0] <= wp.float64(0.0):
        return wp.float64(-1.0)
    e = vec6d(theta[0], theta[1], theta[2], p[0], p[1], p[2])
    total = wp.float64(0.0)
    for m in range(6):
        s = e[m]
        for k in range(m):
            s = s - low[m, k] * e[k]
        e[m] = s / low[m, m]
        total = total + e[m] * e[m]
    return total


@wp.func
def covers(ground: GroundMap, model: MapModel, b: int, cell: int) -> bool:
    """Whether a cell is mapped as ground: a robot proved it, or scans show that nothing stands there."""
    if int(ground.log_odds[b, GROUND, cell]) >= MAPPED:
        return True
    return model.levels > 0 and int(ground.log_odds[b, OBSTACLE, cell]) <= SEEN_FREE


@wp.func
def count_information(
    state: State, ground: GroundMap, truth: Truth, model: MapModel, score: Score, table: wp.array[int], b: int
):
    """Enter this decision's map changes into the team's account.

    Where there is a volume, its cells are counted and what is concluded from them is not.
    """
    w = state.world[b]
    frame = state.frame[b]
    for k in range(ground.change_count[b]):
        change = change_of(ground.changes[b, k])
        place = truth_cell(truth, w, frame, ground, model, b, change.cell)
        if change.layer != OBSTACLE or model.levels == 0:
            fact = is_fact(truth, w, frame, model, place, change.layer)
            gain = held_ubit(table, change.now, fact) - held_ubit(table, change.was, fact)
            score.information[b] = score.information[b] + wp.int64(gain)
        if change.layer < VOLUME and (facts_at(truth, place) & REACHABLE) != 0:
            now = int(covers(ground, model, b, change.cell))
            score.mapped[b] = score.mapped[b] + now - int(score.covered[b, change.cell])
            score.covered[b, change.cell] = wp.int8(now)


@wp.func
def goal_reached(state: State, truth: Truth, b: int) -> bool:
    """Whether the first observer stands, well, at the goal."""
    goal = truth.goal[state.world[b]]
    p = state.position[b, 0]
    away = wp.length(wp.vec2(p[0] - goal[0], p[1] - goal[1]))
    return goal[3] > 0.0 and away <= goal[2] and state.status[b, 0] == ACTIVE


@wp.func
def end_agents(belief: Belief, score: Score, kinds: wp.array[int], model: ScoreModel, b: int):
    """Terminate the lost, and everybody at success or without a camera; truncate the rest at the time limit."""
    n = kinds.shape[0]
    eyes = int(0)
    for r in range(n):
        if (kinds[r] & 2) != 0 and belief.declared[b, r] == WORKING:
            eyes = eyes + 1
    over = score.success[b] == 1 or eyes == 0
    late = belief.clock[b] > model.decisions
    left = int(0)
    for r in range(n):
        score.terminated[b, r] = 0
        score.truncated[b, r] = 0
        if score.alive[b, r] == 1:
            if over or belief.declared[b, r] == LOST:
                score.terminated[b, r] = 1
            elif late:
                score.truncated[b, r] = 1
            score.alive[b, r] = 1 - wp.max(score.terminated[b, r], score.truncated[b, r])
            left = left + score.alive[b, r]
    score.done[b] = int(left == 0)


@wp.func
def count_energy(state: State, score: Score, model: ScoreModel, b: int):
    """Enter the energy drawn in this decision: all of it, and what motion, markers and scanner drew."""
    total = wp.float64(0.0)
    action = wp.float64(0.0)
    for r in range(score.alive.shape[1]):
        e = state.energy[b, r]
        action = action + e[1] + e[2] + e[3]
        total = total + e[0] + e[1] + e[2] + e[3]
    score.terms[b, 1] = -float(total - score.energy[b]) * model.energy
    score.terms[b, 2] = -float(action - score.action_energy[b]) * model.action_energy
    score.energy[b] = total
    score.action_energy[b] = action


@wp.func
def count_losses(state: State, score: Score, kinds: wp.array[int], model: ScoreModel, b: int):
    """Price the robots that were lost, in truth, in this decision."""
    for r in range(kinds.shape[0]):
        status = state.status[b, r]
        if status > ACTIVE and score.prior[b, r] <= ACTIVE:
            if (kinds[r] & 1) != 0:
                score.terms[b, 3] = score.terms[b, 3] - model.picket
            else:
                score.terms[b, 4] = score.terms[b, 4] - model.observer
        score.prior[b, r] = status


@wp.func
def count_consistency(state: State, belief: Belief, score: Score, b: int):
    """Enter how far, in its own measure, the pose of each robot at work is from the truth."""
    for r in range(score.alive.shape[1]):
        if belief.declared[b, r] == WORKING and belief.slot[b, r] != NO_SLOT and state.status[b, r] == ACTIVE:
            nees = pose_nees(state, belief, b, r)
            if nees >= wp.float64(0.0):
                score.nees_sum[b] = score.nees_sum[b] + nees
                score.nees_count[b] = score.nees_count[b] + 1


@wp.func
def accomplished(state: State, truth: Truth, score: Score, model: ScoreModel, b: int) -> bool:
    """Whether the task is done: enough of the reachable ground mapped, or the goal reached."""
    if model.by_coverage == 1:
        return float(score.mapped[b]) >= model.coverage_target * float(score.reachable[b])
    return goal_reached(state, truth, b)


@wp.kernel
def judge(
    state: State, belief: Belief, ground: GroundMap, truth: Truth, map_model: MapModel, model: ScoreModel, score: Score,
    kinds: wp.array[int], table: wp.array[int], running: wp.array[int],
):  # fmt: skip
    """Score the last decision of every running team."""
    b = wp.tid()
    for k in range(score.terms.shape[1]):
        score.terms[b, k] = 0.0
    score.reward[b] = 0.0
    if running[b] == 0:
        return
    had = score.information[b]
    count_information(state, ground, truth, map_model, score, table, b)
    score.terms[b, 0] = float(score.information[b] - had) * MICROBIT * model.information
    count_energy(state, score, model, b)
    count_losses(state, score, kinds, model, b)
    count_consistency(state, belief, score, b)
    if accomplished(state, truth, score, model, b):
        score.success[b] = 1
        score.terms[b, 5] = model.goal
    for k in range(score.terms.shape[1]):
        score.reward[b] = score.reward[b] + score.terms[b, k]
    end_agents(belief, score, kinds, model, b)


@wp.kernel
def open_account(
    state: State, ground: GroundMap, truth: Truth, map_model: MapModel, score: Score, chosen: wp.array[int]
):
    """Start the accounts of the chosen teams anew."""
    b = wp.tid()
    if chosen[b] == 0:
        return
    score.information[b] = wp.int64(0)
    score.mapped[b] = 0
    score.reachable[b] = 0
    score.energy[b] = wp.float64(0.0)
    score.action_energy[b] = wp.float64(0.0)
    score.success[b] = 0
    score.done[b] = 0
    score.nees_sum[b] = wp.float64(0.0)
    score.nees_count[b] = 0
    for cell in range(map_model.nx * map_model.ny):
        score.covered[b, cell] = wp.int8(0)
        place = truth_cell(truth, state.world[b], state.frame[b], ground, map_model, b, cell)
        if (facts_at(truth, place) & REACHABLE) != 0:
            score.reachable[b] = score.reachable[b] + 1
            score.covered[b, cell] = wp.int8(covers(ground, map_model, b, cell))
            score.mapped[b] = score.mapped[b] + int(score.covered[b, cell])
    for r in range(score.alive.shape[1]):
        score.alive[b, r] = 1
        score.prior[b, r] = state.status[b, r]
