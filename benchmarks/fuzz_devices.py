"""Mutated bytes of every stream device: no crash, and no wrong frame beyond the odds of its check sum.

    python benchmarks/fuzz_devices.py --inputs 1000000 --seed 1

Sound frames are mutated (bits, runs, cuts, splices, extreme numbers), cut and decoded. Printed for each device: inputs,
sound frames, frames that failed their check, wrong frames, and how many wrong ones the odds explain. `xarm` and
`pose_lines` have no check of their own, as TCP and UDP have one: what comes out of them must be plausible.
Exit code 1 when there are more wrong frames than that.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.mutated.streams import CHECK_BITS, fuzz


def main() -> int:
    """Fuzz all devices, or some."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", action="append", choices=sorted(CHECK_BITS))
    arguments = parser.parse_args()
    names = arguments.device or sorted(CHECK_BITS)
    is_beyond = False
    for name in names:
        begin = time.process_time()
        tally, bits = fuzz(name, -(-arguments.inputs // len(names)), arguments.seed), CHECK_BITS[name]
        odds = f"wrong ({tally.most_wrong(bits):.0f} explained)" if bits else "changed but plausible"
        print(
            f"{name:12} {tally.inputs} inputs: {tally.sound} sound, {tally.refused} refused, {tally.wrong} {odds}, "
            f"{time.process_time() - begin:.0f} s",
            flush=True,
        )
        is_beyond |= bool(bits) and tally.wrong > tally.most_wrong(bits)
    return int(is_beyond)


if __name__ == "__main__":
    sys.exit(main())
