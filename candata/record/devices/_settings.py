"""Settings behind an address, `?name=text&name=text`: read, with one error for those that a device lacks."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from candata.errors import UnknownNameError, UsageError


def check_names(settings: Mapping[str, str], known: Collection[str]) -> None:
    """Refuse a setting that the device lacks.

    Raises
    ------
    UnknownNameError
        Lists those it has.
    """
    for name in settings:
        if name not in known:
            raise UnknownNameError("setting", name, tuple(known))


def choice(settings: Mapping[str, str], name: str, choices: Collection[str], default: str) -> str:
    """Return one of `choices`.

    Raises
    ------
    UsageError
        When the setting is none of them.
    """
    text = settings.get(name, default)
    if text not in choices:
        raise UsageError(f"the setting {name} is wrong", expected=" or ".join(choices), found=text)
    return text


def number(settings: Mapping[str, str], name: str, default: float, low: float, high: float) -> float:
    """Return a number from `low` to `high`.

    Raises
    ------
    UsageError
        When the setting is none.
    """
    text = settings.get(name, str(default))
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise UsageError(f"the setting {name} is wrong", expected=f"a number from {low:g} to {high:g}", found=text)
    return value
