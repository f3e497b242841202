"""Publishing of what an import read: one version or nothing, and what was added in one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from candata_cli import console

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from candata.schema.episode import Episode
    from candata.schema.manifest import Lineage, VersionFile

#: Episodes that a note names.
_NAMED_EPISODES = 5


def publish_import(
    out: Path,
    append: bool,
    episodes: Iterable[Episode],
    operation: str,
    lineage: Callable[[], Lineage],
    part_size: int = 16,
    clouds: Iterable[NDArray] = (),
    replaces: bool = False,
) -> None:
    """Write all episodes as one version and print what was added; a failure leaves no trace.

    A new dataset is made beside `out` and renamed, so that `out` appears whole or not at all; one that another
    process made meanwhile is added to only where that was asked for. `lineage` and `clouds` are asked once all
    episodes were read. With `replaces`, episodes take the place of those with their ids in what stands.
    """
    from candata.datasets import create_dataset, publish, put_cloud, write_parts
    from candata.datasets.drafts import draft_beside, place
    from candata.datasets.replacing import publish_replacing, write_each
    from candata.datasets.versions import members_of, newest_version

    read_ids: set[str] = set()

    def add(root: Path) -> VersionFile:
        episode_stream = _with_progress(episodes, read_ids)
        writes = write_each if replaces else partial(write_parts, part_size=part_size)
        parts = writes(root, episode_stream, operation)
        for points in clouds:
            put_cloud(root, points)
        return publish_replacing(root, parts, lineage()) if replaces else publish(root, parts, lineage())

    adds = append and out.exists()
    earlier_version = newest_version(out) if adds else None
    with console.stoppable(lambda: f"{out} is as it was" if adds else console.written_clause(out)):
        if adds:
            version = add(out)
        else:
            with draft_beside(out) as folder:
                draft_root = create_dataset(folder / "dataset", name=out.resolve().name)
                version = add(draft_root)
                place(draft_root, out)
    members = members_of(out, version)
    earlier = members_of(out, earlier_version) if earlier_version else {}
    changed_count = sum(members.get(name, content) != content for name, content in earlier.items())
    changed_text = f", {changed_count} replaced" if replaces else ""
    _tell_left_out(out, read_ids.intersection(version.exclusions))
    added_count = len(members) - len(earlier)
    console.out(f"{out}: {added_count} episodes added{changed_text}, {len(members)} in version {version.number}")


def _tell_left_out(out: Path, ids: set[str]) -> None:
    """Tell which episodes were read and yet are not in the version: an earlier one left them out."""
    if ids:
        names = ", ".join(sorted(ids)[:_NAMED_EPISODES]) + (", ..." if len(ids) > _NAMED_EPISODES else "")
        console.note(
            f"{len(ids)} episodes stay left out, as in the version before: {names}; to bring them back, "
            f"import to a new dataset NEW, then: candata registry merge NEW --out {out} --append"
        )


def _with_progress(episodes: Iterable[Episode], read_ids: set[str], every: int = 100) -> Iterator[Episode]:
    """Yield the episodes, with a line on stderr now and then; `read_ids` takes their ids."""
    for count, episode in enumerate(episodes, start=1):
        read_ids.add(episode.meta.id)
        yield episode
        if count % every == 0:
            console.note(f"{count} episodes")
