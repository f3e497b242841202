"""What a policy evaluation found, as records: `policies.json`."""

from __future__ import annotations

from candata.schema.record import ResultRecord


class Interval(ResultRecord):
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float


class PolicyFacts(ResultRecord):
    """A policy: its source, and whether it is `planned` or acts in a `closed loop`."""

    source: str
    kind: str


class PolicyScore(ResultRecord):
    """A policy in one world: its success with a Wilson interval, how episodes ended, and how many were unstable.

    Those that became unstable count in `unstable` alone: neither in `total` nor in `outcomes`.
    `spread_m` is the mean distance of sampled forecasts from their mean [m], None in a simulation.
    """

    policy: str
    world: str
    success: Interval
    count: int
    total: int
    outcomes: dict[str, int]
    unstable: int = 0
    spread_m: float | None = None


class WorldRanking(ResultRecord):
    """How well a world predicts what was seen, over the policies and starts that were.

    `mmrv` is the mean maximum rank violation, `mean_error` the mean distance of success rates, `bias` their mean
    difference (above 0: too hopeful). Calibration: `covered` is the share of policies whose seen rate lies within the
    predicted interval, `agreement` the share of single starts that end alike.
    """

    world: str
    policies: int
    pairs: int
    spearman: Interval
    mmrv: float
    mean_error: float
    bias: float
    covered: float
    agreement: float


class EffectShare(ResultRecord):
    """What one effect of the repair explains.

    Of the `wrong` predictions of the nominal simulator, `explained` are right in the repaired one and wrong again once
    the effect is dropped. `broken` are right in the nominal one, wrong in the repaired one, and right again without the
    effect.
    """

    effect: str
    explained: int
    broken: int
    wrong: int
    share: float


class Disagreement(ResultRecord):
    """The policy and the start for which predicting worlds disagree most: what to record next.

    `distance_m` is the mean distance between the object's positions in the two worlds that differ most, and `commands`
    the world whose commands the motion file holds.
    """

    policy: str
    start: str
    outcomes: dict[str, str]
    distance_m: float
    between: tuple[str, str]
    commands: str


class PolicyEvaluation(ResultRecord):
    """Policies from held-out real starts in several worlds.

    `compared_with` says against what the effects were counted: what was `seen`, or the `repaired` simulator where
    nothing was.
    """

    headline: str
    dataset: str
    split: str
    group: str
    scene: str
    starts: tuple[str, ...]
    duration_s: float
    seed: int
    goal: str | None
    seen: str | None
    policies: dict[str, PolicyFacts]
    worlds: dict[str, str]
    scores: tuple[PolicyScore, ...]
    rankings: tuple[WorldRanking, ...]
    best: str | None
    ahead_of_nominal: Interval | None
    effects: tuple[EffectShare, ...]
    compared_with: str | None
    next_motion: Disagreement | None
    notes: tuple[str, ...]
    revision: str
