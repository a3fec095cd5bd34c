"""The commands of ``perdure home``, over the functions of `perdure.home`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from perdure.cli.home_day import day
from perdure.cli.home_options import (
    EvalSeed,
    Fallback,
    Index,
    PlannerName,
    Policies,
    RunOptions,
    Split,
    Task,
    World,
    given_physics,
    parse_policies,
)
from perdure.cli.parse import Cores, On, call, check_folder
from perdure.errors import PerdureError
from perdure.home.sim.scene import SceneOptions, WorldOptions
from perdure.report.charts import Format

if TYPE_CHECKING:
    from perdure.learn.run import TrainRun

Logs = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(help="Log files, or folders that hold some, of any tasks and release strategies."),
]


def main(command: str, args: list[str]) -> None:
    """Run a command of ``perdure home``."""
    call(COMMANDS[command], args, f"home {command}")


def list_names() -> None:
    """Show the tasks, their published episodes, the skills and the objects."""
    from rich.console import Console
    from rich.table import Table

    from perdure.home.sim.objects import KINDS
    from perdure.home.skills import SKILLS
    from perdure.home.tasks.episodes import PUBLISHED, load_episodes, published_splits
    from perdure.home.tasks.tasks import TASKS

    tasks = Table("task", "targets", "objects", *PUBLISHED, "steps", "stages", title="Tasks")
    for task in TASKS.values():
        published = published_splits(task.name)
        counts = [str(len(load_episodes(task.name, split))) if split in published else "-" for split in PUBLISHED]
        objects = len(task.targets) + sum(number for number, _ in task.clutter)
        stages = " ".join(stage.name for stage in task.stages)
        tasks.add_row(task.name, str(len(task.targets)), str(objects), *counts, str(task.max_steps), stages)
    skills = Table("skill", "steps", "observation size", "success", title="Skills")
    for name, kind in SKILLS.items():
        skills.add_row(name, str(kind().limit), str(len(kind().elements)), kind.success_text)
    kinds = Table("object", "size [mm]", "mass [g]", "shape", title="Objects")
    for name, each in KINDS.items():
        size = " x ".join(f"{1000 * side:.0f}" for side in each.size)
        kinds.add_row(name, size, f"{1000 * each.mass:.0f}", each.shape)
    for table in (tasks, skills, kinds):
        for column in table.columns[:-1]:
            column.no_wrap = True
        Console(width=140, markup=False).print(table)


def episode(
    task: Task,
    split: Split = "val",
    index: Index = 0,
    eval_seed: EvalSeed = 0,
    render: Path | None = None,
    camera: str = "doll_house",
    size: tuple[int, int] = (900, 600),
) -> None:
    """Show where the objects of an episode start, and the goals of its targets.

    Args:
        render: Also render it into this PNG file.
        camera: doll_house, plan, follow, head or hand.
        size: Width and height of the picture in pixels.
    """
    from rich.console import Console
    from rich.table import Table

    from perdure.home.tasks.episodes import episode_hash, load_episodes, start_pose

    shown = load_episodes(task, split)[index]
    apartment = shown.apartment()
    pose = start_pose(apartment, shown, eval_seed)
    print(f"{shown.name} in {apartment.name}, hash {episode_hash(shown)}")
    print(f"robot at ({pose.x:.2f}, {pose.y:.2f}) m, heading {pose.yaw:.2f} rad (evaluation seed {eval_seed})")
    opened = ", ".join(f"{link} {value:.2f}" for link, value in shown.opened.items())
    print(f"open at the start: {opened or 'nothing'}")
    table = Table("", "object", "lies on", "in", "at [m]", "belongs on", "at [m]", box=None, pad_edge=False)
    for column in table.columns:
        column.no_wrap = True
    for number, placement in enumerate(shown.objects):
        place = placement.receptacle.split("|")[0]
        at = _point(placement.position)
        if number < len(shown.goals):
            goal = shown.goals[number]
            goal_place = goal.receptacle.split("|")[0]
            target = (shown.container(number) or "", at, goal_place, _point(goal.position))
            table.add_row(str(number), placement.kind, place, *target)
        else:
            table.add_row("", placement.kind, place, "", at, "", "")
    Console(width=140, markup=False).print(table)
    if render is not None:
        from perdure.film import save_picture
        from perdure.home.pictures import Studio, goal_marks, render_scene

        with Studio(render_scene(shown, eval_seed), size) as studio:
            print(save_picture(studio.take(camera, goal_marks(shown)), render))


def _point(position: tuple[float, float, float]) -> str:
    return " ".join(f"{value:.2f}" for value in position)


def plan(task: Task, pddl: bool = False) -> None:
    """Show a task's plan as a STRIPS planner finds it.

    Args:
        pddl: Print the planning domain and the task's problem in PDDL instead, as other planners read them.
    """
    from rich.console import Console
    from rich.table import Table

    from perdure.home.skills import get_skill
    from perdure.home.tasks.domain import HOME
    from perdure.home.tasks.pddl import domain_pddl, problem_pddl
    from perdure.home.tasks.planning import make_plan, plan_problem

    if pddl:
        print(f"{domain_pddl(HOME)}\n{problem_pddl(plan_problem(task))}", end="")
        return
    table = Table("", "skill", "target", "then", "step limit", title=f"Plan of {task}", box=None)
    for number, step in enumerate(make_plan(task), 1):
        table.add_row(str(number), step.skill, str(step.target), step.toward or "", str(get_skill(step.skill).limit))
    Console().print(table)


@dataclass(frozen=True)
class Shown:
    """An episode and its agents, which a film shows side by side and a live view one after the other."""

    task: Task
    split: Split = "val"
    index: Index = 0
    eval_seed: EvalSeed = 0
    place: tuple[str, ...] = ()
    """Release strategies, as for `perdure home run`: rl when none is given, or all that the logs hold."""
    policies: Policies = ()
    train_seed: int = 0
    """Training seed of the shipped policies."""
    planner: PlannerName = "open"
    fallback: Fallback = "oracle"
    world: World = WorldOptions()  # noqa: RUF009 - frozen
    """The variant of the physics."""
    logs: tuple[Path, ...] = ()
    """Logs, or folders that hold some. The runs of this episode with these seeds are repeated, each with its policies,
    planner and physics."""

    def open(self) -> tuple[Any, list[Any]]:
        """Return the `Episode` and each `Agent` that acts."""
        from perdure.home.evaluate.execute import ExecutorOptions
        from perdure.home.evaluate.log import UNTRAINED
        from perdure.home.evaluate.protocol import EvaluationProtocol
        from perdure.home.failures import read_logged
        from perdure.home.film import Agent
        from perdure.home.tasks.episodes import load_episodes

        if self.train_seed < 0:
            raise PerdureError(f"--train-seed must be 0 or more, not {self.train_seed}")
        chosen = parse_policies(self.policies)
        episode = load_episodes(self.task, self.split)[self.index]
        if not self.logs:
            given = given_physics(self.world)
            scene = SceneOptions(**given)
            options = ExecutorOptions(self.eval_seed, scene=scene, planner=self.planner, fallback=self.fallback)
            first = EvaluationProtocol(self.task, "rl", self.split, episodes=1, policies=chosen, options=options)
            named = [replace(first, place=each).as_trained(given) for each in self.place or ("rl",)]
            return episode, [Agent(each, self.train_seed) for each in named]
        if (self.planner, self.fallback, self.world) != ("open", "oracle", WorldOptions()):
            raise PerdureError("with --logs, planner, fallback and physics are those of the logs: leave them out")
        runs = read_logged(
            log_files(self.logs),
            wanted=lambda log: (
                (log.task, log.split, log.index, log.eval_seed) == (self.task, self.split, self.index, self.eval_seed)
                and log.train_seed in (self.train_seed, UNTRAINED)
                and (not self.place or log.place in self.place)
            ),
        )
        if not runs:
            raise PerdureError(f"the logs hold no such run of {episode.name}: index, seeds or --place differ")
        return runs[0].episode, [each.agent(chosen) for each in runs]


ShownFlags = Annotated[Shown, tyro.conf.OmitArgPrefixes]


def video(
    shown: ShownFlags,
    out: Path = Path("home.mp4"),
    camera: str = "follow",
    release: int | None = None,
    size: tuple[int, int] = (720, 480),
    speed: float | None = None,
) -> None:
    """Film an episode, or one release: several release strategies or logged runs side by side. Needs no screen.

    Args:
        out: The film: .mp4, .gif or .webp.
        camera: follow, doll_house, plan, head or hand.
        release: Film only the release of this target (0 is the first), by a camera that stands still at its goal.
        size: Width and height in pixels, even.
        speed: Playback speed relative to real time; 4 by default, 1 with --release.
    """
    from perdure.home.evaluate.outcomes import latched
    from perdure.home.film import film_episode

    episode, agents = shown.open()
    for log in film_episode(episode, out, agents, camera, size=size, speed=speed, release=release):
        stages = latched(log)
        print(f"{log.strategy.name}: {sum(stages)} of {len(stages)} stages reached in {log.steps} steps")
    print(out)


def view(shown: ShownFlags, port: int = 8080, speed: float = 1.0) -> None:
    """Show an episode live in a browser, each release strategy or logged run in turn. Interrupt it to end.

    Args:
        port: Port of the server on this machine.
        speed: Playback speed relative to real time.
    """
    from perdure.home.film import serve_episode

    try:
        serve_episode(*shown.open(), port, speed, report=partial(print, flush=True))
    except KeyboardInterrupt:
        print()


@dataclass(frozen=True)
class Training:
    """What a skill is trained on, and how."""

    task: str = "set_table"
    """The task whose objects and receptacles it is trained on."""
    variant: str | None = None
    """For place: gentle, hand or delta-N, see `perdure home run --help`."""
    method: str = "ppo"
    """ppo; linear or geometric with the time-to-go as an input; or another of PPO's in `perdure list methods`."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds, such as 0 1 2, trained side by side."""
    steps: int | None = None
    """Environment steps; the recipe's by default."""

    def options(self) -> dict[str, Any]:
        """Return the options of the skill; PerdureError for what was asked for together and does not fit."""
        from perdure.home.skills.place import variant_options

        if self.variant is None:
            return {}
        if self.method != "ppo":
            raise PerdureError("give --variant or --method: no --place names a policy that was trained with both")
        return dict(variant_options(self.variant))

    def run(self, skill: str) -> TrainRun:
        """Return the training run of a skill."""
        from perdure.home.skills.train import skill_run

        return skill_run(skill, self.task, self.seeds, self.steps, self.method, **self.options())


def train(
    skill: tyro.conf.Positional[str],
    training: Annotated[Training, tyro.conf.OmitArgPrefixes] = Training(),
    test_episodes: int = 200,
    out: Path = Path("runs"),
    cores: Cores = None,
    on: On = "local",
) -> None:
    """Train a skill with its recipe and print its success rate on val starts. Interrupt it any time.

    Args:
        skill: pick, place, open_drawer, close_drawer, open_fridge, close_fridge or navigate.
        test_episodes: Episodes on val starts after training.
        out: Folder of the runs.
    """
    from perdure.home.evaluate.plan_starts import record_plan_starts
    from perdure.home.skills.train import evaluate_skill
    from perdure.learn.run import train
    from perdure.policy import load_policy
    from perdure.runs import check_on
    from perdure.runs.progress import show_progress

    if test_episodes < 1:
        raise PerdureError(f"--test-episodes must be 1 or more, not {test_episodes}")
    options = training.options()
    check_folder(out)
    check_on(on)
    training.run(skill)  # what is wrong is said before the minutes of recording
    record_plan_starts(training.task)
    with show_progress(f"{training.task} {skill}", "steps") as show:
        paths = train(training.run(skill), out, cores=cores, on=on, observe=show)
    for path in paths:
        score = evaluate_skill(load_policy(path), skill, test_episodes, task=training.task, **options)
        print(f"{path}\n  {score.summary}")


@dataclass(frozen=True)
class Runs(RunOptions):
    """What is run of a task."""

    episodes: int = 100
    """Number of episodes of the split, from its first one."""


def run(
    task: Task,
    runs: Annotated[Runs, tyro.conf.OmitArgPrefixes] = Runs(),
    cores: Cores = None,
    on: On = "local",
    out: Path = Path("home-runs"),
    command: str = "",
) -> None:
    """Run the benchmark's protocol: episodes x training seeds x evaluation seeds. Interrupt it any time.

    The report lies beside the logs. `perdure home analyze` compares several release strategies.

    Args:
        out: Folder of the logs.
        command: The command line, stored with the logs.
    """
    from perdure.home.evaluate.protocol import run_protocol
    from perdure.runs.progress import show_progress

    check_folder(out)
    protocol = runs.protocol(task, runs.episodes)
    for flags, skills in protocol.trained_otherwise().items():
        print(f"trained with other physics ({flags}): {', '.join(skills)}", file=sys.stderr)
    unusual = protocol.options.scene.words
    if unusual:
        print(f"physics: {', '.join(unusual)}", file=sys.stderr)
    with show_progress(f"{task} {protocol.place}", "episodes") as observe:
        paths = run_protocol(protocol, out, cores=cores, on=on, command=command, observe=observe)
    _compare(paths, out / protocol.folder, command, {}, ("png",))
    print(f"Logs: {out}")


def analyze_logs(
    logs: Logs,
    names: tuple[str, ...] = (),
    out: Path | None = None,
    formats: tuple[Format, ...] = ("png",),
    command: str = "",
) -> None:
    """Print success per stage, failure causes and placements by kind of object, from logs.

    Args:
        names: A word for each file or folder, so that two policies under one release strategy stand side by side.
        out: Folder for report.html, which compares the release strategies, and its figures.
        formats: File formats of the figures beside the page.
        command: The command line, shown on the page.
    """
    if names and len(names) != len(logs):
        raise PerdureError(f"--names must be {len(logs)} words, one for each file or folder, not {len(names)}")
    paths = log_files(logs)
    if out is not None:
        check_folder(out)
    _compare(paths, out, command, dict(zip(logs, names, strict=False)), formats)


def _compare(
    paths: list[Path], out: Path | None, command: str, names: dict[Path, str], formats: tuple[Format, ...]
) -> None:
    """Print the main tables of logs, and write their report into a folder."""
    from perdure.home.evaluate.analysis import analyze
    from perdure.home.evaluate.page import read_all, summary_text, write_page

    records, notes = read_all(paths, names)
    analysis = analyze(records)
    page = None if out is None else write_page(analysis, out, command, notes, formats)
    print(summary_text(analysis, notes))
    if page is not None:
        print(f"\nReport: {page.resolve()}")


def failures(
    logs: Logs,
    count: int = 10,
    seed: int = 0,
    counting: Literal["latched", "stabilizing"] = "stabilizing",
    policies: Policies = (),
    out: Path = Path("failures"),
) -> None:
    """Replay failed episodes, drawn at random, and show the cause of each failure in eight pictures.

    The policies that the logs name act again. Where the replay gets another label (other code, other policies) the line
    says "replayed: ..."; the command then ends with code 1.

    Args:
        count: Number of episodes; all when fewer have failed.
        seed: Seed of the draw.
        counting: Definition of failure: latched (the benchmark's), stabilizing (placements must also last).
        out: Folder for the pictures.
    """
    from perdure.film import check_film, open_context, save_picture
    from perdure.home.failures import failure_sheet, read_logged, replay_failure, sample_failures

    chosen = parse_policies(policies)
    check_folder(out)
    drawn = sample_failures(read_logged(log_files(logs), counting), count, seed)
    if not drawn:
        print(f"no episode of these logs failed ({counting})")
        return
    # Errors are found before anything runs: missing policies, changed episodes, a machine that cannot render.
    agents = [failure.agent(chosen) for failure in drawn]
    for failure in drawn:
        _ = failure.episode
        check_film(out / failure.file_name, (".png",))
    open_context(16, 16).free()
    others = 0
    for failure, agent in zip(drawn, agents, strict=True):
        replay = replay_failure(failure, agent)
        path = save_picture(failure_sheet(failure, replay), out / failure.file_name)
        others += (differs := replay.label != failure.label)
        again = f", replayed: {failure.words(replay.label)}" if differs else ""
        print(f"{failure.log.name}, {failure.words(failure.label)}, {path}{again}", flush=True)
    if others:
        sys.exit(f"perdure: {others} of {len(drawn)} episodes got another label: by other code or policies")


_ALL: tuple[Any, ...] = (list_names, episode, plan, video, view, train, run, day, analyze_logs, failures)
COMMANDS: dict[str, Callable[..., None]] = {each.__name__.partition("_")[0]: each for each in _ALL}
"""Each under the first word of its name."""


def log_files(given: tuple[Path, ...]) -> list[Path]:
    """Return the log files among files and folders; PerdureError when there are none."""
    paths = [path for each in given for path in (sorted(each.rglob("*.parquet")) if each.is_dir() else [each])]
    if not paths:
        raise PerdureError(f"there are no logs (*.parquet) in {', '.join(map(str, given)) or 'nothing: name a folder'}")
    return paths
