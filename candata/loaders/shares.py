"""Shares of a mixture: the text that asks for them, and what each source really gave."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from fractions import Fraction

from candata.errors import UsageError
from candata.schema.record import Record

#: Longest period of a mixture: shares of four decimals.
LONGEST_PERIOD = 10_000

_SHARE = re.compile(r"\d{1,4}/\d{1,4}|\d?\.\d{1,9}|\d{1,4}\.?")


class Mixture(Record):
    """Shares by name: of `sum(parts)` windows, `parts[i]` are of the source `names[i]`."""

    names: tuple[str, ...]
    parts: tuple[int, ...]

    @property
    def shares(self) -> dict[str, float]:
        """Share of each source; they add up to 1."""
        return {name: part / sum(self.parts) for name, part in zip(self.names, self.parts, strict=True)}

    def __str__(self) -> str:
        """Return `sim:0.7,real:0.3`, or fractions where decimals are not exact."""
        total = sum(self.parts)
        shares = [Fraction(part, total) for part in self.parts]
        is_decimal = all(LONGEST_PERIOD % share.denominator == 0 for share in shares)
        texts = [f"{float(share):g}" if is_decimal else str(share) for share in shares]
        return ",".join(f"{name}:{share}" for name, share in zip(self.names, texts, strict=True))


def parse_mixture(text: str) -> Mixture:
    """Return the mixture that a text such as `sim:0.7,real:0.3` or `a:1/3,b:2/3` describes.

    Raises
    ------
    UsageError
        When it is not of this form, a name comes twice, a share is not positive, they do not add up to 1, or they have
        more than four decimals.
    """
    pairs = [part.strip().rpartition(":") for part in text.split(",")]
    names = tuple(name.strip() for name, _, _ in pairs)
    if not all(names) or len(set(names)) < len(names):
        problem = "a mixture names a source twice" if all(names) else "not a mixture"
        raise UsageError(problem, expected="NAME:SHARE,NAME:SHARE, such as sim:0.7,real:0.3", found=repr(text))
    shares = [_share(name, share.strip()) for name, (_, _, share) in zip(names, pairs, strict=True)]
    if sum(shares) != 1:
        raise UsageError(
            "the shares of a mixture do not add up to 1",
            expected="1",
            found=f"{float(sum(shares)):.6g} in {text!r}",
            fix="thirds are written as such: a:1/3,b:2/3",
        )
    period = math.lcm(*(share.denominator for share in shares))
    if period > LONGEST_PERIOD:
        raise UsageError("the shares of a mixture are too fine", expected="four decimals at most", found=repr(text))
    return Mixture(names=names, parts=tuple(int(share * period) for share in shares))


def _share(name: str, text: str) -> Fraction:
    """Return a share, above 0."""
    problem = f"the share of {name} is not a number above 0"
    if not _SHARE.fullmatch(text) or text.endswith("/0"):
        raise UsageError(problem, expected="such as 0.7 or 2/3", found=repr(text))
    try:
        share = Fraction(text.removesuffix("."))
    except ZeroDivisionError:
        share = Fraction(0)
    if share <= 0:
        raise UsageError(problem, expected="such as 0.7 or 2/3", found=repr(text), fix=f"leave {name} out")
    return share


class Effective(Record):
    """The windows that a source really gave by some step.

    Attributes
    ----------
    name : str
        Source.
    asked : float
        Share that was asked for.
    windows, windows_share : int, float
        Windows that it holds, and the share that they would have without a mixture.
    rows, rows_share : int, float
        The same for rows of its episodes.
    drawn, drawn_share : int, float
        Windows drawn.
    unique, unique_share : int, float
        Distinct windows among them, and their share of all distinct ones.
    epochs : float
        How often each of its windows was drawn, in the mean.
    """

    name: str
    asked: float
    windows: int
    windows_share: float
    rows: int
    rows_share: float
    drawn: int
    drawn_share: float
    unique: int
    unique_share: float
    epochs: float


def effective(
    mixture: Mixture, windows: Sequence[int], rows: Sequence[int], draw_counts: Sequence[int], unique: Sequence[int]
) -> tuple[Effective, ...]:
    """Return the numbers of each source, in the order of the mixture, with their shares."""

    def share(values: Sequence[int], number: int) -> float:
        return values[number] / max(1, sum(values))

    return tuple(
        Effective(
            name=name,
            asked=asked_share,
            epochs=draw_counts[i] / windows[i],
            windows=windows[i],
            windows_share=share(windows, i),
            rows=rows[i],
            rows_share=share(rows, i),
            drawn=draw_counts[i],
            drawn_share=share(draw_counts, i),
            unique=unique[i],
            unique_share=share(unique, i),
        )
        for i, (name, asked_share) in enumerate(mixture.shares.items())
    )


def share_report(sources: Sequence[Effective]) -> str:
    """Return a line a source: what was asked for, and what it really gave."""
    return "\n".join(
        f"{source.name}: asked {source.asked:.1%}, drew {source.drawn:,} windows ({source.drawn_share:.1%}), "
        f"{source.unique:,} of {source.windows:,} distinct ({source.unique_share:.1%} of all distinct), "
        f"{source.epochs:.2f} epochs; "
        f"unweighted it would be {source.windows_share:.1%} of the windows, {source.rows_share:.1%} of the rows"
        for source in sources
    )
