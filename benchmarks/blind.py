"""Blind check of the diagnosis: effects are drawn, sealed, diagnosed, and only then opened and scored.

    python benchmarks/blind.py --out out/blind --draws 3 --nulls 6 --seed 1 --noise both

Cases are made one after the other from a secret salt; what the diagnosis reads is a dataset without labels. Results are
kept as JSON lines, so a run that was killed goes on where it stopped. Misses are printed first.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import multiprocessing
import secrets
import time
from pathlib import Path

import numpy as np

SCENE = "xhand_tabletop"
#: Label of a case whose effect, on one element, is drawn with its numbers.
LOCAL = "local"


def plan(out: Path, args: argparse.Namespace) -> list[dict]:
    """Return the cases of a run, made once: number, noise, and a sealed label that only `score` opens."""
    file = out / "sealed.json"
    if not file.exists():
        salt = secrets.token_hex(32)
        rng = np.random.default_rng(int.from_bytes(hashlib.sha256(f"{args.seed}{salt}".encode()).digest()[:8], "big"))
        labels = [n for n in possible() if args.only is None or n in args.only.split(",")] * args.draws
        labels += [None] * args.nulls + [LOCAL] * args.local
        modes = [True, False] if args.noise == "both" else [args.noise == "yes"]
        cases = [(label, noise) for noise in modes for label in labels]
        order = rng.permutation(len(cases))
        sealed = [
            {"number": int(i), "effect": cases[k][0], "noise": cases[k][1], "seed": int(rng.integers(2**31))}
            for i, k in enumerate(order)
        ]
        out.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps({"salt": salt, "cases": sealed}))
    return json.loads(file.read_text())["cases"]


def possible() -> list[str]:
    """Return the effects that can act in the scene."""
    from candata.effects import effect, effect_names
    from candata.scenes import load_scene

    scene = load_scene(SCENE)
    return [name for name in effect_names() if effect(name).possible(scene)]


def check_scene() -> None:
    """Stop unless joints follow their targets and every effect moves a channel: accuracy proves no sane scene."""
    from candata.scenes import load_scene
    from candata.simulate.episodes import Job, make_episodes

    scene = load_scene(SCENE)
    names = possible()
    worlds = [()] + [draw({"effect": n, "seed": 1}, scene) for n in names]
    count = len(scene.policies)
    jobs = [Job(f"{w}-{i}", i, scene.policies[i], 1, world) for w, world in enumerate(worlds) for i in range(count)]
    made = [make_episodes(scene, jobs[k : k + count], duration_s=3.2) for k in range(0, len(jobs), count)]
    sweep = made[0][scene.policies.index("free_sweep")]
    pairs = list(zip(sweep["action"].T, sweep["joint_position"].T, strict=True))
    moving = [(a, q) for a, q in pairs if np.ptp(a) > 0.02]  # rad or m: more than the command noise
    follows = [max(np.corrcoef(a[: len(a) - k], q[k:])[0, 1] for k in range(13)) for a, q in moving]
    print(
        f"{len(moving)} moving joints follow their targets within 150 ms in a free sweep: "
        f"correlation at least {min(follows):.3f}"
    )
    channels = ("joint_position", "object_pose", "fingertip_force")
    moved = {
        name: max(float(np.abs(a[c] - b[c]).max()) for a, b in zip(made[0], world, strict=True) for c in channels)
        for name, world in zip(names, made[1:], strict=True)
    }
    print("largest change of a channel: " + ", ".join(f"{n} {v:.2g}" for n, v in moved.items()))
    if min(follows) < 0.8 or min(moved.values()) < 1e-3:
        raise SystemExit("the scene is not fit for a blind check")


def draw(case: dict, scene) -> tuple:
    """Return the hidden effects of a case."""
    from candata.effects import effect, effect_names, setting

    if case["effect"] is None:
        return ()
    rng = np.random.default_rng(case["seed"])
    name, element = case["effect"], None
    if name == LOCAL:
        name = rng.choice([n for n in effect_names() if effect(n).possible(scene) and effect(n).elements(scene)])
        element = str(rng.choice(effect(name).elements(scene)))
    x = []
    for parameter in effect(name).parameters:
        spans = parameter.draws(scene)
        for _ in range(parameter.size(scene)):
            x.append(rng.uniform(*spans[rng.integers(len(spans))]))
    return (setting(str(name), np.array(x), scene, element),)


def make(case: dict, folder: Path, episodes: int) -> None:
    """Write the case's dataset; nothing in it tells the effect."""
    from candata.datasets import append, create_dataset
    from candata.scenes import load_scene
    from candata.schema.manifest import Lineage
    from candata.simulate.episodes import Job, make_episodes

    scene = load_scene(SCENE)
    effects = draw(case, scene)
    jobs = [
        Job(f"case-{i:04d}", i, scene.policies[i % len(scene.policies)], case["seed"], effects, hidden=True)
        for i in range(episodes)
    ]
    made = make_episodes(scene, jobs, duration_s=3.2, noise=scene.file.noise if case["noise"] else None)
    create_dataset(folder)
    append(folder, made, Lineage(operation="blind case"))


def judge(folder: Path, noise: bool) -> dict:
    """Return the diagnosis of a case, from its dataset alone."""
    from candata.datasets import open_dataset
    from candata.gap import diagnose
    from candata.scenes import load_scene

    scene = load_scene(SCENE)
    if not noise:
        scene = dataclasses.replace(scene, file=scene.file.model_copy(update={"noise": None}))
    start = time.process_time()
    report = diagnose(open_dataset(folder), scene, jobs=1).report
    return json.loads(report.model_dump_json()) | {"cpu_s": time.process_time() - start}


def one(job: tuple[dict, str, int]) -> dict:
    """Make and diagnose one case."""
    case, out, episodes = job
    folder = Path(out) / f"case-{case['number']:04d}"
    if not folder.exists():
        make(case, folder, episodes)
    return {"number": case["number"], "report": judge(folder, case["noise"])}


def score(cases: list[dict], results: dict[int, dict]) -> None:
    """Open the labels and print misses, then rates."""
    from candata.scenes import load_scene

    scene = load_scene(SCENE)
    rows = []
    for case in cases:
        report = results.get(case["number"])
        if report is None:
            continue
        named = [_label(e["name"], e["element"]) for e in report["effects"]]
        hidden = draw(case, scene)
        truth = _label(hidden[0].name, hidden[0].element) if hidden else None
        rows.append(
            {
                "noise": case["noise"], "truth": truth, "named": named, "verdict": report["verdict"],
                "exact": named == [truth], "first": named[:1] == [truth],
                "class": truth in [*named, *report["class"]], "closed": (report["gap"] or {}).get("closed"),
                "local": case["effect"] == LOCAL,
                "error": parameter_error(case, report, scene), "cpu_s": report["cpu_s"], "number": case["number"],
            }
        )  # fmt: skip
    print("Misses:")
    for r in rows:
        if (r["truth"] and not r["exact"]) or (r["truth"] is None and r["named"]):
            print(f"  case {r['number']:4d} noise={r['noise']!s:5} truth {r['truth']}: {r['verdict']} {r['named']}")
    for noise in (True, False):
        title = "declared noise" if noise else "no noise, none declared"
        _summary([r for r in rows if r["noise"] == noise and not r["local"]], title)
        _summary([r for r in rows if r["noise"] == noise and r["local"]], f"{title}, one element")


def _label(name: str, element: str | None) -> str:
    """Return `name` or `name element`."""
    return name if element is None else f"{name} {element}"


def parameter_error(case: dict, report: dict, scene) -> float | None:
    """Return the relative error of the named effect's parameters: distance over size, from the identity."""
    hidden = draw(case, scene)
    found = [
        e for e in report["effects"] if hidden and (e["name"], e["element"]) == (hidden[0].name, hidden[0].element)
    ]
    if not found or isinstance(next(iter(hidden[0].parameters.values())), str):
        return None
    true = np.concatenate([np.atleast_1d(v) for v in hidden[0].parameters.values()])
    seen = np.concatenate([np.atleast_1d(p["value"]) for p in found[0]["parameters"].values()])
    return float(np.linalg.norm(seen - true) / np.linalg.norm(true))


def _summary(rows: list[dict], title: str) -> None:
    """Print the rates of one condition."""
    with_effect, nulls = [r for r in rows if r["truth"]], [r for r in rows if r["truth"] is None]
    if not rows:
        return
    print(f"\n{title}: {len(with_effect)} effects, {len(nulls)} nulls")
    for r in rows:
        r["right_name"] = bool(r["truth"]) and [n.split()[0] for n in r["named"][:1]] == r["truth"].split()[:1]
    if with_effect:
        count = len(with_effect)
        print(f"  exact            {sum(r['exact'] for r in with_effect)}/{count}   target >= 90 %")
        print(f"  first            {sum(r['first'] for r in with_effect)}/{count}")
        print(f"  right name first {sum(r['right_name'] for r in with_effect)}/{count}")
        print(f"  named or in class {sum(r['class'] for r in with_effect)}/{count}")
        closed = [r["closed"] for r in with_effect if r["first"]]
        errors = [r["error"] for r in with_effect if r["first"] and r["error"] is not None]
        if closed:
            print(f"  gap closed when right: median {np.median(closed):.3f}, 10 % {np.quantile(closed, 0.1):.3f}")
        if errors:
            print(f"  parameter error: median {np.median(errors):.3f}, 90 % {np.quantile(errors, 0.9):.3f}")
    if nulls:
        print(f"  false alarms     {sum(bool(r['named']) for r in nulls)}/{len(nulls)}   target 0")
    print(f"  CPU s a case     median {np.median([r['cpu_s'] for r in rows]):.1f}")


def main() -> None:
    """Run or resume the blind check."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/blind"))
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--nulls", type=int, default=6)
    parser.add_argument("--local", type=int, default=0, help="cases of a fault of one joint, fingertip or geom")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise", choices=("yes", "no", "both"), default="both")
    parser.add_argument("--only", help="effects to draw, comma separated")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    check_scene()
    cases = plan(args.out, args)
    log = args.out / "results.jsonl"
    lines = [json.loads(x) for x in log.read_text().splitlines()] if log.exists() else []
    results = {r["number"]: r["report"] for r in lines}
    todo = [(c, str(args.out), args.episodes) for c in cases if c["number"] not in results]
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool, log.open("a") as file:
        for result in pool.imap_unordered(one, todo):
            results[result["number"]] = result["report"]
            file.write(json.dumps(result) + "\n")
            file.flush()
            print(f"{len(results)}/{len(cases)} cases", flush=True)
    score(cases, results)


if __name__ == "__main__":
    main()
