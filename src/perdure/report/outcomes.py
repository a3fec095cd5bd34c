"""Outcomes: the words of verdicts, each with its rule, its meaning, its place, its color and what to do next.

An outcome is a class that registers itself (see `perdure.registry`). Judging, sentences, page, JSON and studies read
this file, so a new word is one class here, or one in another package.

"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from perdure.errors import lookup
from perdure.registry import Registered
from perdure.report.scores import FEWEST_JUDGED, HOLDS_FROM, IDLE_BELOW, EpisodeScores

HELP = "https://github.com/perdure/perdure/blob/main/docs/how-to/when-a-policy-fails.md"


class Advice(NamedTuple):
    """What to do next."""

    sentence: str
    section: str
    """Anchor of its heading on the page `HELP`."""


class Color(NamedTuple):
    """Of a word on a page, as CSS writes it."""

    light: str
    """On a light page."""
    dark: str


COLORS = {
    True: Color("#0a6b3d", "#4cc38a"),
    False: Color("#b3261e", "#ff8a80"),
    None: Color("#8a5a00", "#f5bd41"),
}
"""Of good, bad and undecided outcomes."""


class Outcome(Registered):
    """What became of an episode, as one word: the base of all vocabularies of outcomes.

    A vocabulary is an abstract subclass; its members are frozen dataclasses without fields.
    """

    good: ClassVar[bool | None] = None
    """None: neither good nor bad."""
    order: ClassVar[int] = 0
    """Place among the good, the bad or the undecided ones: in lists, and the first of equally common ones is taken."""
    meaning: ClassVar[str] = ""
    """In one sentence, that begins in lower case and has no period."""
    color: ClassVar[Color | None] = None
    """On a page; None: that of all good, bad or undecided ones."""

    @property
    def page_color(self) -> Color:
        """The color on a page."""
        return self.color or COLORS[self.good]


class EpisodeOutcome(Outcome):
    """What became of an episode beyond the training horizon.

    Most are words of the table's column `outcome`: they have a rule. The others are said of an episode only where a
    policy or a whole task is known, so `perdure.report.groups.episode_verdicts` decides them.
    """

    advice: ClassVar[Advice]
    """What to do next about a policy whose episodes mostly end so."""
    still_seconds: ClassVar[float | None] = None
    """Stills of a failure show what was so many seconds before and after it; None: stills do not help."""
    by_end: ClassVar[bool] = False
    """How the episode ends decides it, whatever rewards it earned: it counts for policies that cannot be judged too."""
    by_goal: ClassVar[bool] = False
    """Whether the episode reached the task's goal decides it; rewards do not count."""
    in_table: ClassVar[bool] = True
    """Whether it is a word of the table."""
    shown_as: ClassVar[str] = ""
    """The word that reports show in its place; "": its own."""

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether an episode has this outcome, if none has that `judging_order` names before."""
        return False

    def failed_step(self, episode: EpisodeScores) -> int:
        """Return the steps completed before the failure began; without a failure, all steps of the episode."""
        return episode.end_step

    @property
    def verb(self) -> str:
        """What several episodes do: "fall"."""
        return self.name.removesuffix("s")


CONFIRM = Advice("Confirm it on other start states (--first-eval-seed).", "it-holds")
CURE = Advice(
    "Train it further, with a longer horizon and under noise (a robot: first perdure robot check).", "cure-it"
)
_INPUTS = "Check normalizer, time feature, training horizon (a robot: perdure robot check). If right, train longer."


@dataclass(frozen=True)
class Holds(EpisodeOutcome):
    """The robot still does at the end what it did in training."""

    name = "holds"
    good = True
    order = 1
    meaning = f"the episode runs to the end, with a final score of at least {HOLDS_FROM:g}"
    advice = CONFIRM

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the final score is high enough."""
        return episode.comparable and episode.decayed is False


@dataclass(frozen=True)
class ReachesGoal(EpisodeOutcome):
    """The episode ended with a success."""

    name = "reaches its goal"
    good = True
    order = 2
    meaning = (
        "the environment ends the episode while it reports a success (`is_success`, `success` or `--success`); rewards "
        "do not count"
    )
    advice = CONFIRM
    by_end = True
    by_goal = True

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the last step of an ended episode is a success."""
        return episode.at_goal and episode.end_reason in ("terminated", "truncated")


@dataclass(frozen=True)
class Falls(EpisodeOutcome):
    """The task ended the episode."""

    name = "falls"
    good = False
    order = 1
    meaning = "the environment terminates the episode, other than at its goal"
    advice = CURE
    still_seconds = 0.3
    by_end = True

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the task ended the episode."""
        return episode.end_reason == "terminated" and not episode.at_goal

    def failed_step(self, episode: EpisodeScores) -> int:
        """Return the steps before the fall, or before the silent failure that it ended."""
        return episode.silent_step


@dataclass(frozen=True)
class FailsSilently(EpisodeOutcome):
    """The robot does nothing useful any more, and the environment does not notice."""

    name = "fails silently"
    good = False
    order = 2
    meaning = (
        f"the episode runs to the end, with a last tenth and a final score below {IDLE_BELOW:g}: the robot is hardly "
        "better than idle"
    )
    advice = Advice("Watch the failure. End training episodes in this posture.", "fails-silently-or-decays")
    still_seconds = 5.0

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the robot is idle at the end."""
        return episode.comparable and episode.silent_for_good

    def failed_step(self, episode: EpisodeScores) -> int:
        """Return the steps before the first idle window after which most are."""
        return episode.silent_step


@dataclass(frozen=True)
class Decays(EpisodeOutcome):
    """The robot does clearly less than in training."""

    name = "decays"
    good = False
    order = 3
    meaning = (
        f"the episode runs to the end, with a final score from {IDLE_BELOW:g} to {HOLDS_FROM:g} that chance does not "
        "explain"
    )
    advice = Advice("Watch the failure. Then compare clocks, or raise gamma.", "fails-silently-or-decays")
    still_seconds = 5.0

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the final score is too low, by more than chance."""
        return episode.comparable and episode.decayed is True

    def failed_step(self, episode: EpisodeScores) -> int:
        """Return the steps before the first low window after which most are."""
        return episode.decay_step


@dataclass(frozen=True)
class Diverges(EpisodeOutcome):
    """The simulation broke."""

    name = "diverges"
    good = False
    order = 4
    meaning = "the simulation becomes invalid"
    advice = Advice("Watch the failure: the physics became invalid.", "diverges")
    by_end = True

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the physics became invalid."""
        return episode.end_reason == "diverged"

    def failed_step(self, episode: EpisodeScores) -> int:
        """Return the steps before the divergence, or before the silent failure that it ended."""
        return episode.silent_step


@dataclass(frozen=True)
class MissesGoal(EpisodeOutcome):
    """Another episode of the task reaches its goal, this one does not."""

    name = "misses its goal"
    good = False
    order = 5
    meaning = (
        "another episode of the task reaches its goal, and this one neither does nor falls or diverges; rewards do not "
        "count"
    )
    advice = Advice("Watch an episode that misses it. Then train longer.", "misses-its-goal")
    by_goal = True
    in_table = False


@dataclass(frozen=True)
class NeverWorked(EpisodeOutcome):
    """The policy does not even work in training; also a state of a policy."""

    name = "never worked"
    good = False
    order = 6
    meaning = (
        "within its own training horizon the policy gains too little over an idle robot, or ends too early where every "
        "step pays the same; this comes before all other outcomes but those of goals"
    )
    advice = Advice(_INPUTS, "never-worked")
    in_table = False


@dataclass(frozen=True)
class CannotTell(EpisodeOutcome):
    """There is no verdict; also a state of a policy."""

    name = "cannot tell"
    order = 1
    meaning = (
        "chance may explain the policy's gain over an idle robot or a low final score, fewer than "
        f"{FEWEST_JUDGED} windows begin after the first tenth of the training horizon, or the environment truncates "
        "the episode"
    )
    advice = Advice("Run more steps and more start states (--steps, --eval-seeds).", "cannot-tell")
    in_table = False


@dataclass(frozen=True)
class Cut(EpisodeOutcome):
    """The environment ended the episode for a reason that is no failure."""

    name = "cut"
    order = 2
    meaning = "in the table: the environment truncates the episode, other than at its goal"
    advice = Advice(
        "Remove the step counter inside the environment, or whatever else truncates episodes.", "cannot-tell"
    )
    shown_as = CannotTell.name

    def applies(self, episode: EpisodeScores) -> bool:
        """Return whether the environment truncated the episode."""
        return episode.end_reason == "truncated" and not episode.at_goal

    def failed_step(self, episode: EpisodeScores) -> int:
        """Return the steps before the truncation, or before the silent failure that it ended."""
        return episode.silent_step


@dataclass(frozen=True)
class Unknown(EpisodeOutcome):
    """No other outcome applies."""

    name = "unknown"
    order = 3
    meaning = "in the table: no other outcome applies"
    advice = CannotTell.advice
    shown_as = CannotTell.name

    def applies(self, episode: EpisodeScores) -> bool:
        """Return True: it is tried last."""
        return True


WORKED = "worked"
"""State of a policy that works within its own training horizon; the other states are words of outcomes."""
POLICY_STATES = (WORKED, NeverWorked.name, CannotTell.name)

FALLS_IN_TRAINING = "falls in training"
FAILS_WHEN_DISTURBED = "fails when disturbed"
ENDS_AT_ONE_STEP = "ends at one step"
SITUATIONS = {
    FALLS_IN_TRAINING: Advice(_INPUTS, "falls-within-its-own-training-horizon"),
    FAILS_WHEN_DISTURBED: CURE,
    ENDS_AT_ONE_STEP: Advice(
        "Check whether the environment reports its time limit as a termination.",
        "falls-within-its-own-training-horizon",
    ),
}
"""Special cases of a verdict, which have an advice of their own."""


def outcomes(**wanted: Any) -> list[EpisodeOutcome]:
    """Return the outcomes with these attributes, such as ``good=False``: good ones first, bad ones, undecided ones."""
    ranks = {True: 0, False: 1, None: 2}
    found = [kind() for kind in EpisodeOutcome.kinds().values()]
    chosen = [each for each in found if all(getattr(each, name) == value for name, value in wanted.items())]
    return sorted(chosen, key=lambda each: (ranks[each.good], each.order, each.name))


def outcome_words(**wanted: Any) -> list[str]:
    """Return the words of the outcomes with these attributes, in the order of `outcomes`."""
    return [each.name for each in outcomes(**wanted)]


def outcome(word: str) -> EpisodeOutcome:
    """Return the outcome of a word; PerdureError if there is none."""
    return lookup(EpisodeOutcome.kinds(), word, "outcome")()


def failures() -> list[str]:
    """Return the words of the table that are failures of an episode, such as "falls"."""
    return outcome_words(good=False, in_table=True)


def verdicts_in_order() -> list[str]:
    """Return the words that reports show, good ones first."""
    return outcome_words(shown_as="")


def judging_order() -> list[EpisodeOutcome]:
    """Return the outcomes of the table in the order in which their rules are tried: bad, good, undecided ones."""
    bad = outcomes(good=False, in_table=True)
    return [*bad, *outcomes(good=True, in_table=True), *outcomes(good=None, in_table=True)]


def find_advice(kind: str) -> Advice:
    """Return what to do next about one of `SITUATIONS`, or about an outcome."""
    return SITUATIONS[kind] if kind in SITUATIONS else outcome(kind).advice


_RANKS = {True: "good", False: "bad", None: "-"}
_OWN = sorted(EpisodeOutcome.__subclasses__(), key=lambda kind: (list(_RANKS).index(kind.good), kind.order))
OWN_TABLE_WORDS = tuple(kind.name for kind in _OWN if kind.in_table)
"""Words of the table that perdure itself defines, for its documentation."""


def _documentation() -> str:
    """Return the table of perdure's own outcomes, in Markdown."""
    rows = [f"| {kind.name} | {_RANKS[kind.good]} | {kind.meaning} | {kind.advice.sentence} |" for kind in _OWN]
    return "\n".join(["| outcome | | an episode has it if | what to do next |", "|---|---|---|---|", *rows])


__doc__ = f"{__doc__ or ''}{_documentation()}"
