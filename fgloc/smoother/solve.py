"""Solving a graph as a whole, and saying in plain words why it cannot be solved."""

import re
from collections.abc import Callable, Collection, Sequence

import gtsam
import numpy as np

from fgloc.errors import SolverError
from fgloc.measurements import Array
from fgloc.smoother.graph import GraphModel, State
from fgloc.smoother.guess import Guess
from fgloc.smoother.model import Model
from fgloc.smoother.native_posts import ROOM
from fgloc.smoother.tree import WholeTree
from fgloc.timing import iso_utc

_MEANING = {
    "x": ("pose", "position or attitude is not held by any measurement"),
    "v": ("velocity", "no IMU interval or second fix holds the speed"),
    "b": ("IMU bias", "its random walk is too small for the precision of the solver, or nothing "
          "observes it"),
    "c": ("slow error", "nothing but its own source observes the position"),
    "a": ("measured point", "the measurement's covariance is not usable"),
    "l": ("lever arm", "its prior is missing"),
    "s": ("survey", "its prior is missing"),
    "p": ("post", "its bending mode or its load is out of all bounds"),
    "u": ("place of another road user", "the covariance of what it tells is not usable"),
    "y": ("axes of the car", "position or attitude is not held by any measurement"),
    "w": ("velocity of the point that does not slide", "the velocity is not held"),
    "k": ("scale and mounting", "no constraint observes them"),
    "m": ("errors of the velocities", "their prior is missing"),
    "t": ("told velocity", "its sigma is not usable"),
    "z": ("zero", "its prior is missing"),
}  # fmt: skip


def optimize(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, model: Model
) -> tuple[gtsam.Values, int]:
    """The optimum by Levenberg-Marquardt, and the number of iterations.

    Plain Gauss-Newton is a third cheaper an iteration, but from a guess that knows nothing of the
    speeds in an outage it climbs first, and under a robust loss it need not come back.
    Raises SolverError that names the state, its time and the missing information.
    """
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(model.config.solver.max_iterations)
    params.setAbsoluteErrorTol(model.config.solver.cost_tolerance)
    params.setRelativeErrorTol(0.0)  # the absolute one decides
    try:
        return _run(graph, values, params)
    except RuntimeError:
        params.setLinearSolverType("MULTIFRONTAL_QR")
    try:
        return _run(graph, values, params)
    except RuntimeError as err:
        raise explain_failure(err, model) from err


def _run(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values,
    params: gtsam.LevenbergMarquardtParams,
) -> tuple[gtsam.Values, int]:  # fmt: skip
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    solved = optimizer.optimize()
    if not np.isfinite(optimizer.error()):
        raise SolverError("the cost is not finite; a measurement is out of all bounds")
    return solved, optimizer.iterations()


def covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, model: Model
) -> Callable[[list[int]], Array]:
    """A function that gives the joint covariance of some variables at a solution.

    Where GTSAM's Cholesky gives up, iSAM2 with QR takes over. Raises SolverError where both do.
    """
    try:
        marginals = gtsam.Marginals(graph, values)
        return lambda keys: (
            marginals.marginalCovariance(keys[0])
            if len(keys) == 1
            else marginals.jointMarginalCovariance(keys).fullMatrix()
        )
    except RuntimeError:
        tree = WholeTree("qr", None)
    try:
        tree.isam.update(graph, values)
    except RuntimeError as err:
        raise explain_failure(err, model) from err
    return tree.covariance


def explain_failure(err: Exception, model: Model) -> SolverError:
    """GTSAM's complaint as a state, a time and what information is missing."""
    found = re.search(r"variable\s+(\d+)", str(err))
    if found is None:
        return SolverError(f"the solver failed: {str(err).strip().splitlines()[0]}")
    symbol = gtsam.Symbol(int(found.group(1)))
    letter, index = chr(symbol.chr()), symbol.index()
    name, missing = _MEANING.get(letter, (letter, "it is not observed"))
    if letter == "b":
        index = int(np.searchsorted(model.bias_of, index))
    elif letter == "p":
        index %= ROOM
    elif letter == "u":
        index = int(model.reference_key[min(index, len(model.reference_key) - 1)])
    elif letter in "ac":
        index = int(model.key_of[min(index, len(model.key_of) - 1)])
    j = min(index, len(model) - 1)
    t_ns = int(model.t_ns[j])
    return SolverError(
        f"the solver failed at the {name} of keyframe {j}, t = {model.t_s[j]:.2f} s "
        f"({iso_utc(t_ns)}): {missing}"
    )


def singular(model: Model, j: int) -> SolverError:
    """What to say where the covariance of a state can no longer be inverted."""
    return SolverError(
        f"the solver failed at keyframe {j}, t = {model.t_s[j]:.2f} s "
        f"({iso_utc(int(model.t_ns[j]))}): its covariance is singular; a fix claims to be "
        "exact, or a measurement is out of all bounds"
    )


def first_values(model: GraphModel, guess: Guess, n: int, rows: Collection[int]) -> gtsam.Values:
    """GTSAM values of the first n keyframes of a guess, biases at zero; see `window_values`."""
    zero = gtsam.imuBias.ConstantBias()
    poses = (
        gtsam.Pose3(gtsam.Rot3(R), p)
        for R, p in zip(guess.R_world_veh[:n], guess.p_world_m[:n], strict=True)
    )
    states = [State(pose, v, zero) for pose, v in zip(poses, guess.v_world_mps[:n], strict=True)]
    return window_values(model, guess.first, states, rows)


def window_values(
    model: GraphModel, first: int, states: Sequence[State], rows: Collection[int],
    with_car: Collection[int] | None = None,
) -> gtsam.Values:  # fmt: skip
    """GTSAM values of the keyframes from `first` on, with the variables that their positions and
    the vehicle's constraints add.

    `rows` are the positions that are in the graph: a variable without a factor, for a row that has
    yet to arrive, would be in the way when it does. `with_car` are those whose constraint
    is; by default all that there are.
    """
    values = gtsam.Values()
    model.insert_shared(values)
    for j, state in enumerate(states, first):
        new_bias = j == first or bool(model.bias_of[j] != model.bias_of[j - 1])
        model.insert(values, j, state, new_bias=new_bias)
        if j in with_car if with_car is not None else model.car.in_force[j]:
            model.car.insert(values, j, state.pose, state.velocity, state.bias)
    for i in rows:
        if first <= model.key_of[i] < first + len(states):
            model.insert_position(values, i)
    return values
