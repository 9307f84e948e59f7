"""One baking task in a process of its own (``python -m generator.bake.worker TASK OUT``).

The maps need variants of Mitsuba (one wavelength at a time; two lamp patterns as colours) other than that of the frames,
and a process has one variant.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

from generator import mitsuba_runtime
from generator.bake.grids import BakedAir, CityGrid, MoonGrid, content_hash
from generator.files import atomic_path

VARIANTS = {"moon": "llvm_ad_mono", "city": "llvm_ad_rgb", "furnace": "llvm_ad_mono"}


def main(task: str, out: Path) -> None:
    """Compute `task` (a key of VARIANTS) and write its mean and error to `out` (.npz)."""
    os.environ[mitsuba_runtime.LLVM_VARIABLE] = mitsuba_runtime.find_llvm().path
    import mitsuba

    mitsuba.set_variant(VARIANTS[task])
    from generator.bake import transfer

    air = BakedAir()
    if task == "furnace":
        (mean, error), key = transfer.furnace(), ""
    elif task == "moon":
        (mean, error), key = transfer.bake_moon(air, MoonGrid()), content_hash(air, MoonGrid())
    else:
        mitsuba.register_emitter("lamp_disk", transfer.LampDisk)
        (mean, error), key = transfer.bake_city(air, CityGrid()), content_hash(air, CityGrid())
    with atomic_path(out) as temporary:
        np.savez_compressed(temporary, mean=mean.astype(np.float32), error=error.astype(np.float32), key=np.array(key))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
