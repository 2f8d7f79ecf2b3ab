"""Results of the evaluation of a window's single samples."""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.estimation.waveform.kernel_noise import KernelVerdict
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.shape_verdict import ShapeVerdict

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class WaveformReading:
    """Flows of a window by its single samples; nan where there is none.

    Attributes
    ----------
    volume_m3_s, volume_std_dev_m3_s : float
        Volume flow on the paddles, from the pulses' shape.
    shape, shape_reason : ShapeVerdict, str
        Whether the shape gives a flow, else why not.
    shape_kg_s, shape_std_dev_kg_s : float
        Volume flow times density, with the density's standard deviation.
    kernels_kg_s, kernels_std_dev_kg_s : float
        From kernel noise.
    kernels, kernels_reason : KernelVerdict, str
        Whether kernel noise gives a flow, else why not.
    kernel_weight_g : float
        Mass of a thousand kernels, as used.
    mean_kg_s, mean_std_dev_kg_s : float
        By the mean force alone.
    combined_kg_s, combined_std_dev_kg_s : float
        All of them combined.
    contradiction : str
        Of shape or kernel noise with the mean force, over the last windows; "" where they agree.
    stretch, bias : float
        Stretch of the shape, and bias of kernel noise, with which their flow would be that of the mean force; median over the
        last windows.
    wave : PatternWave or None
        Harmonics of the paddle pattern; None without a fit.
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
