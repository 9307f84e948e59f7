"""The hypotheses about the thesis that the study answers; H12, about real photographs, is not among them."""

from __future__ import annotations

from types import MappingProxyType

CLAIMS = MappingProxyType(
    {
        "H1": "The adaptive algorithm identifies more frames than the fixed catalogue at magnitude 6.5 and below.",
        "H2": "The gain survives mixed, shuffled conditions with the history reset for each frame.",
        "H3": "A fixed deep catalogue with the N brightest detections matches the adaptive algorithm.",
        "H4": "A fix from many stars beats one from a single star by a factor of 5 to 20.",
        "H5": "With the right projection the one-star median falls to centroid noise; with the wrong one it returns to "
        "about 7 km.",
        "H6": "Recall by an error below 10 km differs from recall by true identification.",
        "H7": "Rejecting or weighting stars by |det J| beats rejecting |dec| > 75 degrees.",
        "H8": "Confidence (normalised votes) is calibrated.",
        "H9": "An attitude error of 0.1 degrees dominates everything else.",
        "H10": "Clouds, the Moon, blur and hot pixels hurt more than limiting magnitude.",
        "H11": "The ranking by time holds at equal code quality.",
        "Label": "A set labelled with a limiting magnitude is as deep as its label says.",
    }
)
