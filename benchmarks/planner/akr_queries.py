"""The AKR of a grasp by Pinocchio, and queries on it that no planner had a hand in."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable

import external_judge
import numpy as np
import pinocchio as pin

NEWTON_STEPS = 60
# Residual of what is drawn, m and rad.
RESIDUAL = 1e-6
# Random configurations: where the base may stand around the handle, and how far a goal may be
# from its start before it is projected.
BASE_REACH_M = (0.4, 1.1)
SPREAD = {"base_m": 0.25, "yaw_rad": 0.4, "arm_rad": 0.3}
GOALS_PER_START = 6


def bare(akr: dict) -> ET.Element:
    """The AKR's joints without shapes, with the limits URDF demands where left out."""
    root = ET.fromstring(akr["urdf"])
    for link in root.findall("link"):
        for part in list(link):
            link.remove(part)
    for limit in root.iter("limit"):
        limit.attrib.setdefault("effort", "1e9")
        limit.attrib.setdefault("velocity", "1e9")
    return root


class Akr:
    """One grasp's AKR (base, arm, the object's joint), and where the object's root belongs."""

    def __init__(self, akr: dict):
        self.description = akr
        whole = pin.buildModelFromXML(ET.tostring(bare(akr), encoding="unicode"))
        rest = pin.neutral(whole)
        for name, value in akr["rest"].items():
            rest[whole.joints[whole.getJointId(name)].idx_q] = value
        locked = [whole.getJointId(n) for n in list(whole.names)[1:] if n not in akr["variables"]]
        self.model = pin.buildReducedModel(whole, locked, rest)
        self.data = self.model.createData()
        self.columns = [self.model.joints[self.model.getJointId(n)].idx_q for n in akr["variables"]]
        self.lower = self.model.lowerPositionLimit[self.columns]
        self.upper = self.model.upperPositionLimit[self.columns]
        self.frame = self.model.getFrameId(akr["anchor_link"])
        self.anchor = external_judge.pose(akr["world_from_anchor_link"])

    def displacement(self, x) -> pin.SE3:
        """Where the object's root is, seen from where it belongs."""
        q = np.empty(self.model.nq)
        q[self.columns] = x
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.anchor.actInv(self.data.oMf[self.frame])

    def error(self, x) -> np.ndarray:
        return pin.log6(self.displacement(x)).vector

    def jacobian(self, x) -> np.ndarray:
        off = self.displacement(x)
        q = np.empty(self.model.nq)
        q[self.columns] = x
        local = pin.ReferenceFrame.LOCAL
        frame = pin.computeFrameJacobian(self.model, self.data, q, self.frame, local)
        return (pin.Jlog6(off) @ frame)[:, self.columns]

    def project(self, x: np.ndarray) -> np.ndarray | None:
        """A configuration near `x` on the constraint, with the object's joint where it is."""
        x = np.clip(x, self.lower, self.upper)
        for _ in range(NEWTON_STEPS):
            error = self.error(x)
            if np.abs(error).max() < RESIDUAL:
                return x
            step = np.linalg.lstsq(self.jacobian(x)[:, :-1], error, rcond=1e-3)[0]
            step *= min(1.0, 0.5 / np.abs(step).max())
            x = np.clip(np.append(x[:-1] - step, x[-1]), self.lower, self.upper)
        return None


class Grasped:
    """One grasp of a task: its AKR, and the external judge's bodies to look for contacts."""

    def __init__(self, file: external_judge.File, akr: Akr, grasp: dict):
        self.file, self.akr, self.grasp = file, akr, grasp
        self.solvers: dict[str, object] = {}

    def kept(self, name: str, make: Callable[[], object]):
        """What a planner needs for this grasp, made when it is first asked for."""
        if name not in self.solvers:
            self.solvers[name] = make()
        return self.solvers[name]

    def rows(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows of robot and object joints in the file's order."""
        robot = np.concatenate([x[:-1], self.grasp["fingers"]])
        moved = self.file.object[0].copy()
        moved[self.file.active] = x[-1]
        return robot, moved

    def is_free(self, x: np.ndarray) -> bool:
        self.file.place(*self.rows(x))
        return self.file.judge.collision() is None

    def handle(self) -> np.ndarray:
        """Centre of the tool at the object's start."""
        judge = self.file.judge
        self.file.place(self.file.robot[0], self.file.object[0])
        link = judge.object_data.oMf[judge.object_model.getFrameId(self.grasp["link"])]
        tool = judge.world_from_object * link * external_judge.pose(self.grasp["link_from_tool"])
        return tool.translation

    def start(self, q: float, rng: np.random.Generator) -> np.ndarray | None:
        """A random free configuration with the object's joint at `q`."""
        x = rng.uniform(self.akr.lower, self.akr.upper)
        angle, reach = rng.uniform(-np.pi, np.pi), rng.uniform(*BASE_REACH_M)
        x[:2] = self.handle()[:2] + reach * np.array([np.cos(angle), np.sin(angle)])
        x[2], x[-1] = rng.uniform(-np.pi, np.pi), q
        x = self.akr.project(x)
        return x if x is not None and self.is_free(x) else None

    def goal(self, start: np.ndarray, q: float, rng: np.random.Generator) -> np.ndarray | None:
        """The nearest to `start` of a few random free configurations with the joint at `q`."""
        scale = np.full(len(start), SPREAD["arm_rad"])
        scale[:3] = SPREAD["base_m"], SPREAD["base_m"], SPREAD["yaw_rad"]
        found = []
        for _ in range(GOALS_PER_START):
            x = start + scale * rng.standard_normal(len(start))
            x[-1] = q
            x = self.akr.project(x)
            if x is not None and self.is_free(x):
                found.append(x)
        return min(found, key=lambda x: np.linalg.norm(x - start), default=None)

    def finding(self, name: str, path: np.ndarray, query: dict) -> external_judge.Finding:
        """The external judge's verdict on dense samples and the middles between them."""
        states = np.empty((2 * len(path) - 1, path.shape[1]))
        states[::2], states[1::2] = path, (path[1:] + path[:-1]) / 2
        robot, moved = map(np.array, zip(*map(self.rows, states), strict=True))
        model = self.file.judge.robot_model
        ids = [model.joints[model.getJointId(n)].idx_v for n in self.file.robot_joints]
        steps = np.abs(np.diff(robot, axis=0)) / model.velocityLimit[ids]
        times = np.concatenate([[0.0], np.cumsum(np.maximum(steps.max(axis=1), 1e-3))])
        candidate = external_judge.Candidate(
            id=name,
            robot=robot,
            object=moved,
            times=times,
            phases=["manipulate"] * len(states),
            grasp=np.array(self.grasp["link_from_tool"]),
            start=query["start"][-1],
            goal=query["goal"][-1],
        )
        return self.file.examine(candidate)


def draw_queries(holds: list[Grasped], count: int, rng: np.random.Generator) -> list[tuple]:
    """Pairs of a hold and a query, grasps and goals in turn."""
    file = holds[0].file
    goals, begin = file.task["goal"]["positions"], float(file.start[0])
    found, attempt = [], 0
    while len(found) < count:
        hold, end = holds[attempt % len(holds)], goals[attempt // len(holds) % len(goals)]
        attempt += 1
        start = hold.start(begin, rng)
        goal = None if start is None else hold.goal(start, end, rng)
        if goal is None:
            continue
        own = {key: hold.grasp[key] for key in ("link", "link_from_tool", "width_m")}
        found.append((hold, own | {"start": start.tolist(), "goal": goal.tolist()}))
    return found
