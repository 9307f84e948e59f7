"""Provenance of a result: versions, machine, date."""

import os
import platform
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import numpy as np
import scipy


def distribution_version() -> str:
    """Version of the installed skybench distribution, which contains celnav and the benchmark."""
    try:
        return metadata.version("skybench")
    except metadata.PackageNotFoundError:
        return "not installed"


def versions() -> dict[str, str]:
    """Versions of everything that affects a result."""
    return {
        "skybench": distribution_version(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def machine() -> dict[str, str]:
    """Processor, number of cores and operating system; nothing that identifies the machine or its user."""
    return {
        "cpu": _cpu_model(),
        "cores": str(os.cpu_count() or 1),
        "system": f"{platform.system()} {platform.machine()}",
    }


def now_utc() -> str:
    """Present time, ISO 8601 with a trailing Z."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name") and ":" in line]
    return models[0] if models else platform.processor() or "unknown"
