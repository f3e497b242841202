"""The program that is written beside an export for mujoco.sysid."""

#: Runs in its own folder with `pip install "mujoco[sysid]"`; candata is not needed.
IDENTIFY = '''"""Fit parameters.yaml to sequences/ with mujoco.sysid; writes identified.yaml.

Needs: pip install "mujoco[sysid]". Written by candata; yours to change.
"""

import json
from pathlib import Path

import mujoco
from mujoco import sysid

HERE = Path(__file__).resolve().parent
#: The places in the model that each component of a parameter sets: number = offset + slope x value.
TARGETS = json.loads((HERE / "targets.json").read_text())


def modifier(components):
    """Return the function that writes a parameter into a spec."""

    def apply(spec, parameter):
        for value, places in zip(parameter.value.ravel(), components):
            for place in places:
                kind, attribute, index = place["kind"], place["attribute"], place["index"]
                owner = spec.option if kind == "option" else getattr(spec, kind)(place["name"])
                number = place["offset"] + place["slope"] * float(value)
                if index is None:
                    setattr(owner, attribute, number)
                else:
                    getattr(owner, attribute)[index] = number

    return apply


def parameters():
    """Return the parameters with bounds, start values, and what they act on."""
    parameters = sysid.ParameterDict.load_from_disk(HERE / "parameters.yaml")
    for name, parameter in parameters.items():
        parameter.modifier = modifier(TARGETS[name])
    return parameters


def sequences():
    """Return the recorded sequences, those of one length together."""
    spec = mujoco.MjSpec.from_file(str(HERE / "MODEL"))
    model = spec.compile()
    groups = {}
    for path in sorted((HERE / "sequences").glob("*.npz")):
        trajectory = sysid.SystemTrajectory.load_from_disk(path, model)
        key = (len(trajectory.control.times), len(trajectory.sensordata.times))
        groups.setdefault(key, []).append((path.stem, trajectory))
    return [
        sysid.ModelSequences(
            f"rows_{rows}",
            spec,
            [name for name, _ in group],
            [trajectory.initial_state for _, trajectory in group],
            [trajectory.control for _, trajectory in group],
            [trajectory.sensordata for _, trajectory in group],
        )
        for (_, rows), group in groups.items()
    ]


if __name__ == "__main__":
    residual = sysid.build_residual_fn(models_sequences=sequences())
    identified, result = sysid.optimize(parameters(), residual)
    identified.save_to_disk(HERE / "identified.yaml")
    print(identified)
'''
