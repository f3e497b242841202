"""What this machine has: versions, extras, devices, sizes; nothing is imported that is not there."""

from __future__ import annotations

import os
import platform
import re
import shutil
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

#: Extras for people who work on candata itself.
_DEVELOPER_EXTRAS = {"dev", "test"}


@dataclass(frozen=True)
class Extra:
    """An optional extra: its packages, which of them are missing, and what to type for them."""

    name: str
    packages: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def hint(self) -> str:
        """One line that installs it."""
        return f'pip install "candata[{self.name}]"'


def version_of(package: str) -> str | None:
    """Return the installed version of a package, None where there is none."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def needs() -> dict[str | None, tuple[str, ...]]:
    """Return the packages that candata needs, by extra (None: always); empty where nothing tells."""
    packages: dict[str | None, list[str]] = {}
    for line in _requirements():
        name = re.match(r"[A-Za-z0-9._-]+", line)
        extra = re.search(r"""extra\s*==\s*["']([^"']+)""", line)
        if name and name.group() != "candata":
            packages.setdefault(extra.group(1) if extra else None, []).append(name.group())
    return {extra: tuple(names) for extra, names in packages.items() if extra not in _DEVELOPER_EXTRAS}


def _requirements() -> list[str]:
    """Return the lines of the installed package, or of the checkout that this code lies in."""
    try:
        return metadata.requires("candata") or []
    except metadata.PackageNotFoundError:
        path = Path(__file__).resolve().parents[1] / "pyproject.toml"
    if not path.is_file():
        return []
    import tomllib

    project = tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    extras = project.get("optional-dependencies", {}).items()
    return [*project["dependencies"], *(f'{line}; extra == "{name}"' for name, lines in extras for line in lines)]


def versions(packages_by_extra: dict[str | None, tuple[str, ...]]) -> dict[str, str | None]:
    """Return versions of candata, Python, the system, and all packages that may be needed; None: not there."""
    from candata import __version__

    packages = dict.fromkeys(name for names in packages_by_extra.values() for name in names)
    base_versions = {"candata": __version__, "python": platform.python_version(), "system": platform.platform()}
    return {**base_versions, **{name: version_of(name) for name in packages}}


def extras(packages_by_extra: dict[str | None, tuple[str, ...]]) -> list[Extra]:
    """Return the extras and what each lacks."""
    return [
        Extra(name, packages, tuple(p for p in packages if version_of(p) is None))
        for name, packages in sorted((n, p) for n, p in packages_by_extra.items() if n is not None)
    ]


def machine() -> dict[str, float | int | None]:
    """Return processors that may be used, and memory and disk of the working folder in GB."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    disk = shutil.disk_usage(Path.cwd())
    total, free = _memory_gb()
    return {
        "processors": usable,
        "memory_gb": total,
        "memory_free_gb": free,
        "disk_gb": round(disk.total / 1e9, 1),
        "disk_free_gb": round(disk.free / 1e9, 1),
    }


def _memory_gb() -> tuple[float | None, float | None]:
    """Return memory in all and free; None where the system does not tell."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        kilobytes = {name: int(rest.split()[0]) for name, rest in (line.split(":") for line in lines)}
        return round(kilobytes["MemTotal"] * 1.024e-6, 1), round(kilobytes["MemAvailable"] * 1.024e-6, 1)
    except (OSError, ValueError, KeyError, IndexError):
        return None, None


def serial_ports() -> list[str] | None:
    """Return the serial ports; None where pyserial is missing."""
    try:
        from serial.tools import list_ports
    except ImportError:
        return None
    return [f"{port.device} ({port.description})" for port in sorted(list_ports.comports())]


def gpus() -> list[str] | None:
    """Return what torch can compute on beside the CPU; None where torch is missing."""
    try:
        import torch
    except ImportError:
        return None
    names = (
        [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())] if torch.cuda.is_available() else []
    )
    return [*names, *(["Apple GPU (mps)"] if torch.backends.mps.is_available() else [])]
