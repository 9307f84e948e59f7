"""Choice of the form of a lens by cross-validation: every form is judged by held-out stars.

The frame is divided into cells, and the cells are assigned at random to five folds, so that a star and its neighbours are
held out together; a form gains nothing by following nearby stars. The loss of a star is its squared distance in standard
deviations, at most 25. Of all forms whose mean loss exceeds the least one by no more than one standard error of the
difference (over cells), the one with the fewest parameters is chosen (the one-standard-error rule: Breiman, Friedman, Olshen
& Stone 1984, Classification and Regression Trees, section 3.4.3; here for paired differences).

Forms are tried in two rounds: first all laws with their radial terms, then decentring, tilt, thin prism and aspect on the
best laws. In narrow fields a pinhole is tried, with and without a radial term and an aspect, because further terms would act
like a rotation of the camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.bundle import Bundle, Observations, adjust, residuals
from celnav.calibrating.lens_form import LAWS, LensForm
from celnav.camera import Camera
from celnav.errors import CalibrationError, CameraError
from celnav.identification.verification import rotation_of

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

FOLDS = 5
MOST_LOSS = 25.0
MOST_STARS = 3000
# A form with at least this loss on the stars it is fitted to is not cross-validated; on held-out stars it is worse still.
HOPELESS_LOSS = 8.0
MOST_GROWTH = 4.0
"""Largest accepted growth of chi-squared at one standard deviation; at this value, errors are half as large as stated."""
_CELLS = 12  # along the longer side
_SEED = 20240229
_ADDED = (
    ("aspect",),
    ("decentring",),
    ("tilt",),
    ("decentring", "aspect"),
    ("decentring", "tilt"),
    ("decentring", "tilt", "prism"),
    ("decentring", "tilt", "prism", "aspect"),
)
_LAWS_ADDED_TO = 2
NARROW_RAD = 0.12
# The rational terms k4 to k6 of the perspective lens belong together.
_RADIAL_TERMS = {"brown_conrady": (1, 2, 3, 6), "kannala_brandt": (1, 2, 3, 4)}


@dataclass(frozen=True, eq=False)
class Judged:
    """A form and its performance on held-out stars.

    Attributes
    ----------
    form : LensForm
        The form.
    loss : float
        Mean loss of held-out stars; 2 if the form leaves nothing but noise.
    excess, excess_sigma : float
        Excess of the loss over that of the best form, and the standard error of this difference.
    held_out_px : float
        Weighted root mean square distance of held-out stars along an axis; distant stars count as 5 standard deviations.
    """

    form: LensForm
    loss: float
    excess: float
    excess_sigma: float
    held_out_px: float


def choose_form(
    bundle: Bundle, seen: Observations, group: Rows, models: tuple[str, ...] = LAWS, *, opencv_only: bool = False
) -> tuple[LensForm, list[Judged]]:
    """Choose the form of the lens.

    Parameters
    ----------
    bundle : Bundle
        A general lens fitted to the stars.
    seen : Observations
        n matched stars with standard deviations.
    group : ndarray, shape (n,)
        Index of the attitude that each star belongs to.
    models : tuple of str
        Laws to choose among.
    opencv_only : bool
        Consider only forms that OpenCV has: perspective lenses with all additions, Kannala-Brandt's without any.

    Returns
    -------
    LensForm, list of Judged
        The chosen form, and all judged forms, best first.

    Raises
    ------
    CalibrationError
        When none of the models can show the field.
    """
    if len(seen) > MOST_STARS:
        rows = np.sort(np.random.default_rng(_SEED).permutation(len(seen))[:MOST_STARS])
        seen, group = seen.take(rows), group[rows]
    cell = _cells(seen.uv, bundle.size)
    fold = np.random.default_rng(_SEED).permutation(int(cell.max()) + 1)[cell] % FOLDS
    widest = _widest_rad(bundle, seen, group)
    losses: dict[LensForm, F8] = {}

    def judge(forms: list[LensForm]) -> None:
        for form in forms:
            if form not in losses and (in_opencv(form) or not opencv_only):
                losses[form] = held_out_loss(bundle, form, seen, group, fold)

    # Pixels known not to be square are so for every law.
    radial = [replace(form, aspect=bundle.form.aspect) for form in radial_forms(widest, models)]
    judge(radial)
    narrow = widest < NARROW_RAD
    # If decentring is large, radial forms cannot be compared without it. In a narrow field it cannot be separated from the
    # principal point.
    judge([] if narrow else [replace(form, decentring=True) for form in radial])
    if not losses:
        limited = ", as far as OpenCV can hold them," if opencv_only else ""
        raise CalibrationError(
            f"none of the models {', '.join(models)} (--models){limited} can show the field, whose stars reach "
            f"{math.degrees(widest):.0f} deg from the axis: name others too, such as kannala_brandt"
        )
    best_laws = sorted(
        {f.model for f in losses}, key=lambda law: min(v.mean() for f, v in losses.items() if f.model == law)
    )
    for law in best_laws[:_LAWS_ADDED_TO]:
        of_law = {form: loss for form, loss in losses.items() if form.model == law}
        base = _simplest(of_law, cell)[0]
        judge(
            [
                LensForm(law, base.radial, "aspect" in added, "decentring" in added, "prism" in added, "tilt" in added)
                for added in (_ADDED[:1] if narrow else _ADDED)
            ]
        )
    chosen, judged = _simplest(losses, cell)
    weight = float(np.mean(1 / seen.sigma_px**2))
    listed = [
        Judged(form, float(losses[form].mean()), excess, sigma, math.sqrt(float(losses[form].mean()) / 2 / weight))
        for form, excess, sigma in judged
    ]
    return chosen, sorted(listed, key=lambda one: one.loss)


def in_opencv(form: LensForm) -> bool:
    """Return whether OpenCV can represent a lens of this form."""
    if form.model in ("pinhole", "brown_conrady"):
        return True
    plain = not (form.decentring or form.prism or form.tilt)
    return form.model in ("kannala_brandt", "equidistant") and plain


def radial_forms(widest_rad: float, models: tuple[str, ...]) -> list[LensForm]:
    """Return all laws with each number of radial terms; perspective laws only for fields that they can show.

    Within 7 deg of the axis, all laws equal a pinhole with one radial term, to 0.03 px in a frame of 1,000 px.
    """
    if widest_rad < NARROW_RAD and "pinhole" in models:
        return [LensForm("pinhole"), *([LensForm("brown_conrady", 1)] if "brown_conrady" in models else [])]
    forms = []
    for model in models:
        if (model in ("pinhole", "brown_conrady") and widest_rad > 1.4) or (
            model == "orthographic" and widest_rad > 1.5
        ):
            continue
        forms += [LensForm(model, terms) for terms in _RADIAL_TERMS.get(model, (0,))]
    return forms


def held_out_loss(bundle: Bundle, form: LensForm, seen: Observations, group: Rows, fold: Rows) -> F8:
    """Return the loss of each star, shape (n,), under the lens fitted to the other folds."""
    loss = np.full(len(seen), MOST_LOSS)
    try:
        whole = adjust(started(bundle, form), seen, group, robust=False)
    except (np.linalg.LinAlgError, CameraError):  # a law that cannot show the field at all
        return loss
    inside = _loss(whole, seen, group)
    if float(inside.mean()) > HOPELESS_LOSS:
        return inside
    if not knows_its_errors(whole, seen, group):
        return loss
    for number in range(FOLDS):
        out = fold == number
        if not out.any() or out.all():
            continue
        fitted = adjust(whole, seen.take(~out), group[~out], robust=False)
        loss[out] = _loss(fitted, seen.take(out), group[out])
    return loss


def knows_its_errors(fitted: Bundle, seen: Observations, group: Rows) -> bool:
    """Return whether the covariance of a fitted lens holds up to one standard deviation in the least certain direction.

    If positions depend on the parameters as they do at the best fit, chi-squared of the stars grows by 1 there. If many terms
    follow few stars, it grows by far more, or the lens can no longer show the field: such a covariance states errors that no
    position has.
    """
    assert fitted.cov is not None
    assert fitted.turn_by_lens is not None
    sigma = np.sqrt(np.diag(fitted.cov))
    variance, axes = np.linalg.eigh(fitted.cov / np.outer(sigma, sigma))
    step = sigma * axes[:, -1] * math.sqrt(max(float(variance[-1]), 0.0))
    if not np.isfinite(step).all():
        return False
    best = float(_squares(fitted, seen, group).sum())
    for way in (step, -step):
        turned = np.stack(
            [rotation_of(by_lens @ way) @ R for by_lens, R in zip(fitted.turn_by_lens, fitted.rotations, strict=True)]
        )
        try:
            moved = replace(fitted, values=fitted.values + way, rotations=turned)
            grown = float(_squares(moved, seen, group).sum()) - best
        except CameraError:
            return False
        if not grown < MOST_GROWTH:
            return False
    return True


def _squares(bundle: Bundle, seen: Observations, group: Rows) -> F8:
    """Return the squared distance of each star in standard deviations, shape (n,); NaN where the lens cannot show it."""
    left = residuals(bundle, seen, group)
    return np.asarray(np.einsum("ni,ni->n", left, left) / seen.sigma_px**2)


def _loss(bundle: Bundle, seen: Observations, group: Rows) -> F8:
    return np.asarray(np.minimum(np.nan_to_num(_squares(bundle, seen, group), nan=MOST_LOSS), MOST_LOSS))


def started(bundle: Bundle, form: LensForm) -> Bundle:
    """Return a bundle of another form, with the same attitudes and as much of the lens as both forms have."""
    camera = bundle.form.camera(bundle.values, bundle.size)
    same = form.model == bundle.form.model
    near = Camera(form.model, *bundle.size, camera.f_px, camera.fy_px, camera.cx_px, camera.cy_px,
                  k=camera.k[: form.radial] if same else (), p=camera.p, s=camera.s, tilt_rad=camera.tilt_rad)  # fmt: skip
    values = form.values_of(near)
    return Bundle(form, bundle.size, values, bundle.rotations, centre_sigma_px=bundle.centre_sigma_px)


def _simplest(losses: dict[LensForm, F8], cell: Rows) -> tuple[LensForm, list[tuple[LensForm, float, float]]]:
    """Apply the one-standard-error rule; also return each form's excess over the best, and its standard error."""
    best = min(losses, key=lambda form: float(losses[form].mean()))
    judged = []
    for form, loss in losses.items():
        difference = loss - losses[best]
        by_cell = np.bincount(cell, weights=difference - difference.mean())
        judged.append((form, float(difference.mean()), float(np.sqrt((by_cell**2).sum())) / len(loss)))
    within = [form for form, excess, sigma in judged if excess <= sigma]
    return min(within, key=lambda form: (len(form.names), float(losses[form].mean()))), judged


def _cells(uv: F8, size: tuple[int, int]) -> Rows:
    side = max(size) / _CELLS
    column, row = np.clip(uv // side, 0, _CELLS - 1).astype(np.intp).T
    return np.unique(column * _CELLS + row, return_inverse=True)[1]


def _widest_rad(bundle: Bundle, seen: Observations, group: Rows) -> float:
    turned = np.einsum("nj,nj->n", bundle.rotations[group][:, 2], seen.dirs)
    return float(np.arccos(np.clip(turned.min(), -1, 1)))
