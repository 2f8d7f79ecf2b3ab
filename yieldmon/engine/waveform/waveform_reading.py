"""What the samples of one window say beside their mean."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.estimation.waveform.kernel_noise import KernelVerdict
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class WaveformReading:
    """What a window's samples say; nan where they say nothing.

    volume_m3_s, volume_std_dev_m3_s: volume flow on the paddles. shape_kg_s, shape_std_dev_kg_s: the same times density, the
    density's standard deviation in it. shape, shape_reason: whether there is one, and why not. kernels_kg_s,
    kernels_std_dev_kg_s: from kernel noise. kernels, kernels_reason: whether it gives a flow, and why not. kernel_weight_g:
    of a thousand kernels, as used. mean_kg_s, mean_std_dev_kg_s: by the mean force alone. combined_kg_s,
    combined_std_dev_kg_s: all of them together. contradiction: of shape or kernel noise with the mean force, over the last
    windows; empty where they agree. stretch: the one with which the shape's flow would be that of the mean force, median over
    the same windows. bias: the same of kernel noise. wave: harmonics of the paddle pattern, None where there is no fit.
    """

    volume_m3_s: float = _NAN
    volume_std_dev_m3_s: float = _NAN
    shape: ShapeVerdict = ShapeVerdict.NOT_LOOKED_AT
    shape_reason: str = ""
    shape_kg_s: float = _NAN
    shape_std_dev_kg_s: float = _NAN
    kernels_kg_s: float = _NAN
    kernels_std_dev_kg_s: float = _NAN
    kernels: KernelVerdict = KernelVerdict.NOT_LOOKED_AT
    kernels_reason: str = ""
    kernel_weight_g: float = _NAN
    mean_kg_s: float = _NAN
    mean_std_dev_kg_s: float = _NAN
    combined_kg_s: float = _NAN
    combined_std_dev_kg_s: float = _NAN
    contradiction: str = ""
    stretch: float = _NAN
    bias: float = _NAN
    wave: PatternWave | None = None


NOTHING = WaveformReading()
