"""OMPL's path for a query: RRT-Connect in a projected state space, then its own simplification."""

from __future__ import annotations

import time

import numpy as np
from akr_queries import Akr, Grasped
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

# OMPL's own tolerance of the constraint, m and rad.
TOLERANCE = 1e-4
# CPU time that simplification may take of what a query is allowed.
SIMPLIFY_SHARE = 0.2


def prepare(seed: int) -> None:
    """Fixes OMPL's random numbers."""
    ou.RNG.setSeed(seed + 1)
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)


class Anchored(ob.Constraint):
    """The object's root stays: six equations, the logarithm of its displacement."""

    def __init__(self, akr: Akr):
        self.akr, self.seconds = akr, 0.0
        super().__init__(len(akr.columns), 6, TOLERANCE)

    def function(self, x, out) -> None:
        begin = time.process_time()
        out[:] = self.akr.error(x)
        self.seconds += time.process_time() - begin

    def jacobian(self, x, out) -> None:
        begin = time.process_time()
        out[:, :] = self.akr.jacobian(x)
        self.seconds += time.process_time() - begin


def plan(grasped: Grasped, query: dict, seconds: float) -> dict:
    """One query; the box of the base is that of start and goal and half a metre around."""
    akr, constraint = grasped.akr, Anchored(grasped.akr)
    start, goal = np.array(query["start"]), np.array(query["goal"])
    lower, upper = akr.lower - 1e-6, akr.upper + 1e-6
    lower[:3] = np.maximum(lower, np.minimum(start, goal) - 0.5)[:3]
    upper[:3] = np.minimum(upper, np.maximum(start, goal) + 0.5)[:3]
    ambient = ob.RealVectorStateSpace(len(start))
    bounds = ob.RealVectorBounds(len(start))
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    ambient.setBounds(bounds)
    space = ob.ProjectedStateSpace(ambient, constraint)
    information = ob.ConstrainedSpaceInformation(space)
    setup = og.SimpleSetup(information)
    checking = 0.0

    def values(state) -> np.ndarray:
        return np.array([state[i] for i in range(len(start))])

    def is_valid(state) -> bool:
        nonlocal checking
        begin = time.process_time()
        x = values(state)
        free = bool((x >= lower).all() and (x <= upper).all()) and grasped.is_free(x)
        checking += time.process_time() - begin
        return free

    setup.setStateValidityChecker(is_valid)
    ends = []
    for end in (start, goal):
        state = space.allocState()
        state.copy([float(v) for v in end])
        ends.append(state)
    setup.setStartAndGoalStates(ends[0], ends[1])
    setup.setPlanner(og.RRTConnect(information))
    begin = time.process_time()
    # Budgets of CPU time: those of a clock would depend on what else runs.
    setup.solve(ob.PlannerTerminationCondition(lambda: time.process_time() - begin > seconds))
    path, reason = None, "no path within the time limit"
    if setup.haveExactSolutionPath():
        found = setup.getSolutionPath()
        until = time.process_time() - begin + SIMPLIFY_SHARE * seconds
        stop = ob.PlannerTerminationCondition(lambda: time.process_time() - begin > until)
        og.PathSimplifier(information).simplify(found, stop, True)
        found.interpolate()
        path = [values(found.getState(i)).tolist() for i in range(found.getStateCount())]
        reason = None
    cpu = time.process_time() - begin
    called = constraint.seconds + checking
    return {"path": path, "reason": reason, "cpu_s": cpu, "called_s": called}
