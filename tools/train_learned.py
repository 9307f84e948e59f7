"""Train the network of the solver `learned`: python tools/train_learned.py [--samples 10] [--out FILE]. Takes ten minutes.

Needs PyTorch: pip install 'skybench[learned]', or the smaller one without GPU support, pip install torch --index-url
https://download.pytorch.org/whl/cpu. Training uses one core. Meanwhile it prints for how many of 8192 patterns of other
fields the star is the first that the network names, and is among the first five.

Detections are generated from the catalogue, with noise as in rendered frames. Its ranges are those of `celnav.detect` on
twelve rendered dev frames of each condition of tools/rivals_tries.py, with the 60 brightest detections of each frame. Medians
of the conditions: 0.003 to 0.065 deg between detection and star; magnitudes scattered by 0.18 to 0.57 (1.48 times the median
deviation) with long tails (standard deviation 0.36 to 1.06); 5 to 70 % missing of the stars to the magnitude that nine of ten
detected ones reach; 0 to 15 % false, in single frames up to 67 %. There are 4 to 1100 detections in a frame.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmark.solvers.learned.network import FAINTEST_CLASS_V, WEIGHTS, Network, write_network
from benchmark.solvers.learned.patterns import MOST_DETECTIONS, PATTERN_SIZE, patterns_of
from benchmark.solvers.star_naming import EPOCH_JYEAR
from celnav.sky.catalog import load_catalog, propagate

if TYPE_CHECKING:
    import torch
    from torch import nn

HIDDEN = (512, 192)
BATCH = 2048
LEARNING_RATE = 3e-3
WARM_UP_STEPS = 100
SEED = 7301
TESTED = 8192
FEWEST = 4
"""Least number of detections of a field that makes patterns."""
FAINTEST_V = 7.0
"""Magnitude limit of the stars in the fields."""


class Fields:
    """Random fields of stars, seen by a pinhole of 35 to 120 deg.

    Attributes
    ----------
    classes : ndarray of int, shape (n,)
        Class of each star of the catalogue to `FAINTEST_V`, -1 where it is too faint to be a class.
    """

    def __init__(self, class_ids: NDArray[np.int64], seed: int) -> None:
        stars = load_catalog()
        stars = stars.take(stars.v_mag < FAINTEST_V)
        places = propagate(stars.vectors, stars.motion, EPOCH_JYEAR - stars.epoch_jyear)
        self._places = places / np.linalg.norm(places, axis=1, keepdims=True)
        self._v_mag = stars.v_mag
        numbers = {int(each): row for row, each in enumerate(class_ids)}
        self.classes = np.array([numbers.get(int(each), -1) for each in stars.star_id])
        self._random = np.random.default_rng(seed)

    def draw(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Draw one field: unit vectors (n, 3), magnitudes and classes (-1: none) of its detections, brightest first."""
        random = self._random
        half = np.radians(random.uniform(35.0, 120.0) / 2.0) if random.random() < 0.5 else np.radians(30.0)
        x_most = np.tan(half)
        y_most = x_most * random.choice([0.75, 2.0 / 3.0, 1.0, 0.5625])
        seen = self._places @ Rotation.from_quat(random.normal(size=4)).as_matrix()
        front = seen[:, 2] > 0.2
        safe = np.where(front, seen[:, 2], 1.0)
        rows = np.flatnonzero(front & (np.abs(seen[:, 0] / safe) < x_most) & (np.abs(seen[:, 1] / safe) < y_most))
        xy = seen[rows, :2] / seen[rows, 2:]
        # Scatter of the magnitudes with long tails, cloud or air over a part of the frame, and stars lost at random.
        scatter = random.uniform(0.1, 0.6)
        mags = self._v_mag[rows] + scatter * random.standard_t(3, len(rows))
        if random.random() < 0.4:
            mags += random.uniform(0.0, 1.5) * (xy @ random.normal(size=2)) / x_most
        mags = np.maximum(mags, random.uniform(-1.0, 3.0))  # saturated stars are alike
        mags = mags + 1e-3 * random.random(len(rows))
        kept = random.random(len(rows)) > random.choice([0.0, 0.1, 0.2, 0.5])
        # The number of detections determines the magnitude limit.
        wanted = int(np.exp(random.uniform(np.log(8.0), np.log(1.6 * MOST_DETECTIONS))))
        order = np.flatnonzero(kept)[np.argsort(mags[kept])][:wanted]
        rows, xy, mags = rows[order], xy[order], mags[order]
        # Position noise in the image plane, and a small error of the supplied focal length.
        pixel = 2.0 * x_most / random.choice([480.0, 640.0, 1080.0])
        xy = xy + random.choice([0.05, 0.3, 1.0]) * pixel * random.normal(size=xy.shape)
        xy = xy * (1.0 + random.choice([0.0, 0.003, 0.01]) * random.normal())
        classes = self.classes[rows].astype(np.int64)
        false = random.binomial(len(rows), random.choice([0.0, 0.03, 0.1, 0.3]))
        if false and len(rows) > 1:
            xy = np.vstack((xy, random.uniform(-1.0, 1.0, (false, 2)) * [x_most, y_most]))
            mags = np.concatenate((mags, random.uniform(mags[0], mags[-1] + 0.1, false)))
            classes = np.concatenate((classes, np.full(false, -1)))
        order = np.argsort(mags)[:MOST_DETECTIONS]
        rays = np.column_stack((xy[order], np.ones(len(order))))
        return rays / np.linalg.norm(rays, axis=1, keepdims=True), mags[order], classes[order]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=float, default=10.0, help="millions of patterns to train with")
    parser.add_argument("--out", type=Path, default=WEIGHTS)
    asked = parser.parse_args()
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(SEED)
    stars = load_catalog()
    star_ids = stars.star_id[stars.v_mag < FAINTEST_CLASS_V].astype(np.int64)
    model = model_of(len(star_ids))
    train(model, Fields(star_ids, SEED), Fields(star_ids, SEED + 1), math.ceil(asked.samples * 1e6 / BATCH))
    write_network(asked.out, network_of(model, star_ids))
    print(f"{asked.out}: {asked.out.stat().st_size} bytes, {len(star_ids)} stars")


def model_of(n_stars: int) -> nn.Sequential:
    """Layers with batch normalisation, which `network_of` folds into the trained weights."""
    from torch import nn

    sizes = (PATTERN_SIZE, *HIDDEN)
    hidden = [
        layer
        for inputs, outputs in zip(sizes, HIDDEN, strict=False)
        for layer in (nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.ReLU())
    ]
    return nn.Sequential(*hidden, nn.Linear(HIDDEN[-1], n_stars))


def train(model: nn.Sequential, fields: Fields, others: Fields, steps: int) -> None:
    """Minimise the cross-entropy with AdamW; the rate rises, then falls as a cosine."""
    import torch
    from torch import nn

    patterns, classes = batch_of(others, TESTED)
    optimiser = torch.optim.AdamW(model.parameters(), lr=LEARNING_RATE, weight_decay=1e-4)
    started = time.process_time()
    for step in range(steps):
        rate = min(1.0, (step + 1) / WARM_UP_STEPS) * (0.5 + 0.5 * math.cos(math.pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * rate + 1e-6
        seen, named = batch_of(fields, BATCH)
        model.train()
        with torch.autocast("cpu", dtype=torch.bfloat16):
            scores = model(seen)
        loss = nn.functional.cross_entropy(scores.float(), named)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if (step + 1) % 500 == 0 or step + 1 == steps:
            model.eval()
            with torch.no_grad():
                first = model(patterns).topk(5, 1).indices == classes[:, None]
            one, five = first[:, 0].float().mean(), first.any(1).float().mean()
            spent = time.process_time() - started
            print(f"{step + 1} of {steps} steps, {spent:.0f} s: {one:.3f} first, {five:.3f} in five", flush=True)


def batch_of(fields: Fields, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Patterns of stars that the network must know, and their classes."""
    import torch

    patterns: list[NDArray[np.float32]] = []
    classes: list[NDArray[np.int64]] = []
    while sum(map(len, classes)) < size:
        rays, magnitudes, named = fields.draw()
        if len(rays) >= FEWEST:
            known = named >= 0
            patterns.append(patterns_of(rays, magnitudes)[known])
            classes.append(named[known])
    return torch.from_numpy(np.vstack(patterns)[:size]), torch.from_numpy(np.concatenate(classes)[:size])


def network_of(model: nn.Sequential, star_ids: NDArray[np.int64]) -> Network:
    """The trained layers, each with its normalisation folded into its weights."""
    import torch
    from torch import nn

    layers = []
    modules = list(model)
    for place, layer in enumerate(modules):
        if not isinstance(layer, nn.Linear):
            continue
        weights, bias = layer.weight.detach(), layer.bias.detach()
        after = modules[place + 1] if place + 1 < len(modules) else None
        if isinstance(after, nn.BatchNorm1d):
            scale = after.weight.detach() / torch.sqrt(after.running_var + after.eps)
            weights, bias = weights * scale[:, None], (bias - after.running_mean) * scale + after.bias.detach()
        layers.append((weights.numpy().T.copy(), bias.numpy().copy()))
    return Network(tuple(layers), star_ids)


if __name__ == "__main__":
    main()
