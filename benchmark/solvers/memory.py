"""Peak memory of a process, per frame."""

import os
from pathlib import Path


def reset_peak(pid: int | None = None) -> bool:
    """Reset the peak of a process' resident memory; False where the system does not offer this (proc(5))."""
    try:
        Path(f"/proc/{os.getpid() if pid is None else pid}/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


def peak_mib(pid: int | None = None) -> float | None:
    """Largest resident memory (MiB) of a process, by default this one, since the last reset; None where unknown."""
    try:
        lines = Path(f"/proc/{os.getpid() if pid is None else pid}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    found = [line.split()[1] for line in lines if line.startswith("VmHWM:")]
    return int(found[0]) / 1024.0 if found else None
