"""Episodes written step by step: the logs an executor would make, without a simulator."""

import math
from collections import Counter
from contextlib import contextmanager
from functools import cache

import numpy as np

from perdure.home.evaluate.execute import Recorder
from perdure.home.evaluate.log import FinalObject, SkillRun
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import NOTHING

AWAY = np.array([-5.0, -5.0, 1.0])
"""Where the gripper is when it does nothing."""
NOTES = {"command": "a story"}


@cache
def episodes(task):
    return load_episodes(task, "val")


class Story:
    """A world whose state is set by hand; `wait` makes it pass."""

    def __init__(self, task="prepare_groceries", index=0, eval_seed=0, episode=None):
        self.episode, self.eval_seed = episode or episodes(task)[index], eval_seed
        self.attempts = Counter()
        self.goals = self.episode.goal_positions
        targets = len(self.goals)
        self.objects = np.array([placement.position for placement in self.episode.objects[:targets]])
        self.up = np.ones(targets)
        self.held = NOTHING
        self.containers = {"drawer": 0.0, "fridge": float(self.episode.opened.get("top_door", 0.0))}
        self.gripper, self.base = AWAY.copy(), np.array([-5.5, -5.0, 0.0])
        self.force, self.diverged = 0.0, False
        self.touched = np.zeros(targets, dtype=bool)
        self.rows, self.runs = [], []

    @property
    def plan(self):
        return [(step.skill, step.target) for step in make_plan(self.episode.home_task)]

    def wait(self, steps=1, speed=None):
        """Lets steps pass; `speed` of all objects, from their motion when None."""
        for _ in range(steps):
            before = self.rows[-1]["objects"] if self.rows else self.objects
            moved = 30.0 * np.linalg.norm(self.objects - before, axis=1)
            self.rows.append(
                {
                    "objects": self.objects.copy(),
                    "held": self.held,
                    "containers": tuple(self.containers.values()),
                    "up": self.up.copy(),
                    "speed": moved if speed is None else np.full(len(moved), speed),
                    "gripper": self.gripper.copy(),
                    "base": self.base.copy(),
                    "force": self.force,
                    "touched": self.touched.copy(),
                }
            )
        return self

    @contextmanager
    def run(self, skill, target, ending="stopped", forced=False, force=0.0):
        begin, self.force = len(self.rows), force
        yield
        self.force = 0.0
        self.ended(skill, target, begin, ending, True, forced)
        if forced:
            self.held = NOTHING

    def ended(self, skill, target, begin, *how):
        self.attempts[skill, target] += 1
        attempt = self.attempts[skill, target]
        self.runs.append(SkillRun(skill, target, attempt, "", False, begin, len(self.rows), *how))

    def slide(self, target, by, steps, tilt=0.0, gripper=None):
        """Moves an object evenly and tilts it evenly; the gripper beside it when an offset is given."""
        start, lean = self.objects[target].copy(), math.degrees(math.acos(self.up[target]))
        for step in range(1, steps + 1):
            self.objects[target] = start + np.asarray(by) * step / steps
            self.up[target] = math.cos(math.radians(lean + tilt * step / steps))
            if gripper is not None:
                self.gripper = self.objects[target] + gripper
            self.wait()
        self.gripper = AWAY.copy()
        return self

    def pick(self, target):
        with self.run("pick", target):
            self.gripper = self.objects[target] + [0.0, 0.0, 0.1]
            self.wait(2)
            self.held, self.gripper = target, AWAY.copy()
            self.objects[target] = AWAY
            self.wait(3)
        return self

    def place(self, target, above=0.02, beside=0.0, speed=0.0, tilt=0.0, forced=False, force=0.0, way=0.0):
        """Puts an object down. `way`: how far the robot moves in the last step before it lets go."""
        with self.run("place", target, "timed out" if forced else "stopped", forced, force):
            self.objects[target] = self.goals[target] + [beside, 0.0, above]
            self.gripper = self.objects[target].copy()
            self.up[target] = math.cos(math.radians(tilt))
            self.wait(3)
            self.base[0] += way
            self.gripper[1] += way
            self.wait(1, speed)
            if not forced:
                self.held = NOTHING
                self.objects[target, 2] = self.goals[target, 2]
                self.wait()
                self.gripper = AWAY.copy()
                self.wait(5)
        if forced:
            self.objects[target, 2] = self.goals[target, 2]
            self.gripper = AWAY.copy()
        return self

    def go(self, target, **placing):
        return self.pick(target).place(target, **placing)

    def rest(self, targets):
        """The remaining targets of a task of picks and places, as they should be."""
        for target in targets:
            self.go(target)
        return self

    def log(self, settle=150, meanwhile=None):
        """Ends the episode and lets it settle; `meanwhile` is what happens first in the settling time."""
        steps = len(self.rows)
        if meanwhile is not None:
            meanwhile(self)
        if not self.diverged:
            self.wait(settle)
        recorder = Recorder(self.episode, self.runs, [tuple(row.values()) for row in self.rows], self.diverged)
        objects = tuple(FinalObject(o.kind, o.position, o.quaternion, 0.0, False) for o in self.episode.objects)
        return recorder.log(steps, objects, place="story", train_seed=100, eval_seed=self.eval_seed)


def good(index=0, eval_seed=0):
    """PrepareGroceries as it should be."""
    return Story(index=index, eval_seed=eval_seed).rest(range(3)).log()


def random_log(rng, index=0, task="prepare_groceries"):
    """A log in which anything may happen at any step, and the plan may end anywhere."""
    story = Story(task, index)
    targets = len(story.goals)
    story.diverged = bool(rng.random() < 0.1)
    last = int(rng.integers(1, len(story.plan) + 1))
    for number, (skill, target) in enumerate(story.plan[:last]):
        forced = bool(skill == "place" and rng.random() < 0.3)
        begin = len(story.rows)
        for _ in range(int(rng.integers(1, 4))):
            _anything(story, rng, targets)
        ending = "task limit" if number == last - 1 else "timed out" if forced else "stopped"
        story.ended(skill, target, begin, ending, False, forced)
    if rng.random() < 0.5:  # everything ends in its goal
        story.objects[:], story.held = story.goals, NOTHING
    story.held = story.held if rng.random() < 0.1 else NOTHING
    return story.log(settle=int(rng.integers(20, 40)))


def _anything(story, rng, targets):
    for target in range(targets):
        if rng.random() < 0.4:
            inside = rng.random() < 0.7
            story.objects[target] = story.goals[target] + ([0.0, 0.0, 0.01] if inside else rng.normal(size=3))
    if rng.random() < 0.4:
        story.held = int(rng.integers(-2, targets))
    story.up = np.clip(rng.normal(0.8, 0.5, size=targets), -1.0, 1.0)
    story.containers["drawer"] = float(rng.choice([0.0, 0.2, 0.45]))
    story.containers["fridge"] = float(rng.choice([0.0, 1.0, 2.0]))
    story.force = float(rng.choice([0.0, 3000.0], p=[0.9, 0.1]))
    story.gripper = story.objects[int(rng.integers(targets))] + rng.normal(0.0, 0.2, size=3)
    story.wait(speed=float(rng.choice([0.0, 1.0])))
