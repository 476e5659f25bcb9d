"""Losses with their gradients. A value is a float, a gradient has the type and the shape of the first argument."""

from ._core import image_loss, l1, nu_loss, ssim, wavelet_loss
from ._core import total_variation as tv

__all__ = ["image_loss", "l1", "nu_loss", "ssim", "tv", "wavelet_loss"]
