"""Array helpers that keep complex perturbations intact, so that one code serves values and complex-step derivatives.

Comparisons look at real parts only; everything else is analytic. Source of the method: Squire and Trapp, "Using complex
variables to estimate derivatives of real functions", SIAM Review 40 (1998).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AnyArray = NDArray[Any]
"""float64, or complex128 when a derivative is carried along."""

COMPLEX_STEP = 1e-30


def real(x: AnyArray) -> Array:
    """Real part, as float64."""
    return x.real


def perturbed(x: AnyArray) -> bool:
    """Whether x carries a complex perturbation."""
    return x.dtype.kind == "c"


def refuse_shapes(where: str, given: Mapping[str, Any]) -> None:
    """Refuse arrays that do not broadcast.

    Parameters
    ----------
    where : str
        For the message.
    given : mapping
        Arrays and numbers by name; None: not given.

    Raises
    ------
    ValueError
        With the shapes.
    """
    shapes = {name: np.shape(value) for name, value in given.items() if value is not None}
    try:
        np.broadcast_shapes(*shapes.values())
    except ValueError:
        listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
        raise ValueError(f"{where}: shapes {listed}: expected shapes that broadcast") from None


def distinct(x: Array) -> Array:
    """x with its first axis shortened to 1 where all along it are equal, as the real parts of perturbed values are."""
    if x.ndim < 3 or x.shape[0] == 1:
        return x
    return x[:1] if bool((x[:1] == x).all()) else x


def span(values: Array) -> tuple[float, float]:
    """Smallest and largest."""
    return float(values.min()), float(values.max())


def median(values: Array) -> float:
    """Median of values (n,), n >= 1, as `np.median` to the last bit in an eighth of its time for a hundred; nan for a nan."""
    ordered = np.sort(values)
    half = ordered.size // 2
    if ordered[-1] != ordered[-1]:
        return float("nan")
    return float(ordered[half]) if ordered.size % 2 else 0.5 * float(ordered[half - 1] + ordered[half])


def minimum(a: AnyArray, b: AnyArray) -> AnyArray:
    """Elementwise minimum by real part; the derivative follows the chosen branch."""
    return np.where(real(a) <= real(b), a, b)


def maximum(a: AnyArray, b: AnyArray) -> AnyArray:
    """Elementwise maximum by real part; the derivative follows the chosen branch."""
    return np.where(real(a) >= real(b), a, b)


def _carried(x: AnyArray, value: Array, slope: Array) -> AnyArray:
    """A function's value at the real part of x, with the perturbation of x carried to first order.

    value, slope: at `distinct` of that real part.
    """
    out = np.empty(x.shape, dtype=np.complex128)
    out.real = value
    np.multiply(slope, x.imag, out=out.imag)
    return out


def exp(x: AnyArray) -> AnyArray:
    """Exponential; a perturbation is carried to first order, at a fraction of the time of the complex function."""
    if not perturbed(x):
        return np.asarray(np.exp(x))
    value = np.exp(x.real)
    return _carried(x, value, value)


def sin_cos(x: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Sine and cosine, as `exp`."""
    if not perturbed(x):
        return np.sin(x), np.cos(x)
    at = distinct(x.real)
    sin, cos = np.sin(at), np.cos(at)
    return _carried(x, sin, cos), _carried(x, cos, -sin)


def arccos(x: AnyArray) -> AnyArray:
    """Inverse cosine, as `exp`; at 1, where the slope has no bound, a perturbation is lost."""
    if not perturbed(x):
        return np.asarray(np.arccos(x))
    at = distinct(x.real)
    square = 1.0 - at * at
    slope = -1.0 / np.sqrt(np.where(square > 0.0, square, np.inf))
    return _carried(x, np.arccos(at), slope)


def erf(x: AnyArray) -> AnyArray:
    """Error function, as `exp`."""
    from scipy.special import erf as of_real

    if not perturbed(x):
        return np.asarray(of_real(x))
    at = distinct(x.real)
    return _carried(x, of_real(at), 2.0 / np.sqrt(np.pi) * np.exp(-at * at))


def arctan(x: AnyArray) -> AnyArray:
    """Inverse tangent, as `exp`."""
    if not perturbed(x):
        return np.asarray(np.arctan(x))
    at = distinct(x.real)
    return _carried(x, np.arctan(at), 1.0 / (1.0 + at * at))


def sqrt(x: AnyArray) -> AnyArray:
    """Square root, as `exp`; at 0 a perturbation is lost."""
    if not perturbed(x):
        return np.asarray(np.sqrt(x))
    value = np.sqrt(x.real)
    return _carried(x, value, 0.5 / np.where(value > 0.0, value, np.inf))


def power(x: AnyArray, exponent: AnyArray) -> AnyArray:
    """x to a power, x not negative; 0 stays 0, without a slope, as powers of 0 have none for every exponent."""
    positive = real(x) > 0.0
    raised: AnyArray = exp(exponent * np.log(np.where(positive, x, 1.0)))
    return np.where(positive, raised, 0.0)


@lru_cache(maxsize=16)
def gauss_legendre(nodes: int) -> tuple[Array, Array]:
    """Nodes and weights of the Gauss-Legendre rule on [0, 1]; each of shape (nodes,)."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (x + 1.0), 0.5 * w


@lru_cache(maxsize=16)
def chebyshev_points(count: int) -> Array:
    """Chebyshev-Lobatto points on [0, 1], ascending, shape (count,)."""
    return 0.5 * (1.0 - np.cos(np.pi * np.arange(count) / (count - 1)))


_ROOT_POINTS = 24
"""At which a root is bracketed."""


def first_root(
    function: Callable[[AnyArray], AnyArray],
    upper: AnyArray,
    *,
    refinements: int = 1,
    unperturbed: Callable[[AnyArray], AnyArray] | None = None,
) -> AnyArray:
    """First root in (0, upper] of a smooth function that is negative at 0, along the last axis.

    function maps an array of shape (..., n) to values of the same shape; upper has shape (..., 1). Where the function is not
    negative at 0 the root is 0; where it stays negative up to `upper`, the root is `upper`. The result has shape (..., 1) and
    carries complex perturbations of the function to first order.

    unperturbed: the function without perturbations, where it has some.
    """
    search = unperturbed or function
    end, grid = real(upper), chebyshev_points(_ROOT_POINTS)
    over_grid = search(end * grid)
    f = real(over_grid)
    positive = f >= 0.0
    right = positive.argmax(axis=-1)[..., None]
    left = np.maximum(right - 1, 0)
    a, b = end * grid[left], end * grid[right]
    rows, flat = np.arange(right.size).reshape(right.shape), f.reshape(-1, _ROOT_POINTS)
    fa, fb = flat[rows, left], flat[rows, right]
    found = fb >= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.where(fb > fa, a - fa * (b - a) / (fb - fa), b)
    for _ in range(refinements):
        h = 1e-3 * (b - a) + 1e-12
        probe = np.concatenate((x - h, x, x + h), axis=-1)
        probed = real(search(probe))
        fm, f0, fp = probed[..., :1], probed[..., 1:2], probed[..., 2:]
        slope, curve = (fp - fm) / (2.0 * h), (fp - 2.0 * f0 + fm) / (h * h)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = f0 / slope
            step = newton * (1.0 + 0.5 * newton * curve / slope)
        x = np.clip(np.where(np.isfinite(step), x - step, x), a, b)
    x = np.where(found, np.where(right == 0, 0.0, x), end)
    if unperturbed is None and not perturbed(over_grid):
        return x
    value = function(x)
    if perturbed(value):
        h = 1e-6 * end + 1e-12
        beside = real(search(np.concatenate(np.broadcast_arrays(x + h, x - h), axis=-1)))
        slope = (beside[..., :1] - beside[..., 1:]) / (2.0 * h)
        inside = found & (right > 0)
        x = np.where(inside, x - 1j * np.imag(value) / np.where(inside, slope, 1.0), np.where(found, x, upper))
    return x
