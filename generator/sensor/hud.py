"""A head-up display drawn over the picture, as flight controllers add to their video, and the mask of its pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

Mask = NDArray[np.bool_]


def hud_mask(width: int, height: int, lines: tuple[str, ...]) -> Mask:
    """Pixels of an overlay: a cross at the centre, a pitch ladder, a frame of corners, and lines of text at the top left.

    Returns
    -------
    (height, width) bool array
    """
    image = Image.new("1", (width, height))
    draw = ImageDraw.Draw(image)
    middle_u, middle_v, arm = width // 2, height // 2, max(4, height // 30)
    draw.line([(middle_u - arm, middle_v), (middle_u + arm, middle_v)], fill=1)
    draw.line([(middle_u, middle_v - arm), (middle_u, middle_v + arm)], fill=1)
    for rung in (-2, -1, 1, 2):
        v = middle_v + rung * height // 8
        for side in (-1, 1):
            draw.line([(middle_u + side * 2 * arm, v), (middle_u + side * 4 * arm, v)], fill=1)
    margin = max(2, height // 40)
    for u, du in ((margin, 1), (width - 1 - margin, -1)):
        for v, dv in ((margin, 1), (height - 1 - margin, -1)):
            draw.line([(u, v), (u + du * 2 * arm, v)], fill=1)
            draw.line([(u, v), (u, v + dv * 2 * arm)], fill=1)
    for number, line in enumerate(lines):
        draw.text((2 * margin, 2 * margin + 12 * number), line, fill=1)
    return np.array(image, dtype=bool)
