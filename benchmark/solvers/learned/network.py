"""The network of the solver `learned`, in NumPy: from patterns to the probabilities of the stars that it knows.

It has two hidden layers, ReLU, and one output per star; that of Rijlaarsdam et al. 2020 (see `patterns`) has one hidden
layer. tools/train_learned.py trains its weights, which are stored next to this file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

WEIGHTS = Path(__file__).with_name("weights.npz")
FAINTEST_CLASS_V = 5.5
"""Magnitude limit of the stars that the network knows."""


@dataclass(frozen=True)
class Network:
    """Weights and biases of the layers, and the stars of the outputs.

    Attributes
    ----------
    layers : tuple of (ndarray, ndarray)
        Shapes (inputs, outputs) and (outputs,).
    star_ids : ndarray of int64, shape (m,)
        As in docs/solver_protocol.md.
    """

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    star_ids: NDArray[np.int64]

    def probabilities(self, patterns: NDArray[np.float32]) -> NDArray[np.float32]:
        """Probability of each star for each pattern, shape (n, m)."""
        values = patterns
        for weights, bias in self.layers[:-1]:
            values = np.maximum(values @ weights + bias, 0.0)
        weights, bias = self.layers[-1]
        scores = values @ weights + bias
        scores = np.exp(scores - scores.max(axis=1, keepdims=True))
        return scores / scores.sum(axis=1, keepdims=True)


@lru_cache(maxsize=1)
def trained_network() -> Network:
    """The trained network."""
    return read_network(WEIGHTS)


def read_network(path: Path) -> Network:
    """Read weights from the arrays ``weights0``, ``bias0`` and so on, and ``star_ids``; nothing in the file is executed."""
    with np.load(path, allow_pickle=False) as stored:
        numbers = range(sum(name.startswith("bias") for name in stored.files))
        layers = [(stored[f"weights{n}"].astype(np.float32), stored[f"bias{n}"].astype(np.float32)) for n in numbers]
        return Network(tuple(layers), stored["star_ids"].astype(np.int64))


def write_network(path: Path, network: Network) -> None:
    """Write weights in half precision."""
    arrays: dict[str, NDArray[np.generic]] = {"star_ids": network.star_ids.astype(np.int32)}
    for number, (weights, bias) in enumerate(network.layers):
        arrays[f"weights{number}"] = weights.astype(np.float16)
        arrays[f"bias{number}"] = bias.astype(np.float16)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
