"""TrajOpt's path for a query, by the Python wrappers of Tesseract (`tesseract-robotics`).

Sequential convex optimisation (Schulman et al., IJRR 2014) of as many waypoints as ours, from a
straight line: squared velocities and accelerations as costs, and as constraints that both ends and,
in between, the object's root stay where they are. The object's joint moves as it likes between.
"""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import tesseract_robotics.tesseract_common as common
import tesseract_robotics.tesseract_motion_planners_trajopt as trajopt
from akr_queries import Akr, Grasped, bare
from tesseract_robotics.tesseract_environment import Environment

WAYPOINTS = 30
# Samples from one waypoint to the next, each projected onto the constraint afterwards, as ours are.
SUBSTEPS = 5
TOLERANCE = 1e-4
ITERATIONS = 100
# The wrapper's own function passes a plotter that it does not accept.
optimise = (
    trajopt.tesseract_motion_planners_trajopt_python._tesseract_motion_planners_trajopt_python
)
optimise = optimise.OptimizeProblem


def prepare(seed: int) -> None:
    """Nothing of it is random."""


def environment(akr: dict) -> Environment:
    """The AKR's joints, without shapes; those that do not move are fixed where they rest."""
    root = bare(akr)
    name = root.get("name")
    srdf = f'<robot name="{name}" version="1.0.0"></robot>'
    found = Environment()
    locator = common.GeneralResourceLocator()
    if not found.init(ET.tostring(root, encoding="unicode"), srdf, locator):
        raise SystemExit(f"{name}: Tesseract refuses the URDF")
    return found


class Solver:
    """The environment of one grasp."""

    def __init__(self, akr: Akr):
        self.akr = akr
        self.environment = environment(akr.description)
        self.group = self.environment.getJointGroup("akr", akr.description["variables"])

    def anchor(self):
        return common.Isometry3d(self.akr.anchor.homogeneous)

    def joint_term(self, kind, term_type, steps: tuple[int, int], weight: float, targets):
        term = kind()
        term.name = f"{kind.__name__}{steps[0]}"
        term.term_type = term_type
        term.first_step, term.last_step = steps
        term.coeffs, term.targets = np.full(len(targets), weight), np.asarray(targets)
        return term

    def problem(self, start: np.ndarray, goal: np.ndarray):
        """The problem, and what must live as long."""
        info = trajopt.ProblemConstructionInfo(self.environment)
        info.kin = self.group
        basic = info.basic_info
        basic.n_steps, basic.manip, basic.use_time = WAYPOINTS, "akr", False
        info.basic_info = basic
        begin = info.init_info
        begin.type, begin.data = trajopt.InitInfo.GIVEN_TRAJ, np.linspace(start, goal, WAYPOINTS)
        info.init_info = begin
        settings = info.opt_info
        settings.cnt_tolerance, settings.max_iter = TOLERANCE, ITERATIONS
        info.opt_info = settings
        last, constraints, costs = WAYPOINTS - 1, info.cnt_infos, info.cost_infos
        terms = []
        hold, pay = trajopt.TermType_TT_CNT, trajopt.TermType_TT_COST
        for step in range(1, last):
            term = trajopt.CartPoseTermInfo()
            term.name, term.term_type, term.timestep = f"anchor{step}", hold, step
            term.source_frame, term.target_frame = self.akr.description["anchor_link"], "world"
            term.target_frame_offset = self.anchor()
            term.pos_coeffs = term.rot_coeffs = np.full(3, 10.0)
            terms.append((constraints, term))
        for step, ends in ((0, start), (last, goal)):
            kind = trajopt.JointPosTermInfo
            terms.append((constraints, self.joint_term(kind, hold, (step, step), 5.0, ends)))
        still = np.zeros(len(start))
        for kind, weight in ((trajopt.JointVelTermInfo, 1.0), (trajopt.JointAccTermInfo, 5.0)):
            terms.append((costs, self.joint_term(kind, pay, (0, last), weight, still)))
        for kept, term in terms:
            kept.append(term)
        info.cnt_infos, info.cost_infos = constraints, costs
        return trajopt.ConstructProblem(info), (info, terms)


def plan(grasped: Grasped, query: dict, seconds: float) -> dict:
    """One query. The optimiser has no limit of CPU time that it keeps, and does not need one."""
    solver = grasped.kept("trajopt", lambda: Solver(grasped.akr))
    start, goal = np.array(query["start"]), np.array(query["goal"])
    begin = time.process_time()
    problem, _alive = solver.problem(start, goal)
    waypoints = np.array(optimise(problem).traj)
    cpu = time.process_time() - begin
    answer = {"path": None, "reason": None, "cpu_s": cpu}
    if cpu > seconds:
        return answer | {"reason": "no path within the time limit"}
    if max(np.abs(grasped.akr.error(x)).max() for x in waypoints) > 10 * TOLERANCE:
        return answer | {"reason": "constraint not met"}
    waypoints[0], waypoints[-1] = start, goal
    path = [start]
    for a, b in pairwise(waypoints):
        for share in np.arange(1, SUBSTEPS + 1) / SUBSTEPS:
            x = grasped.akr.project(a + (b - a) * share)
            if x is None:
                return answer | {"reason": "constraint not met"}
            path.append(x)
    return answer | {"path": [x.tolist() for x in path]}
