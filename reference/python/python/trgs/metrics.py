"""Metrics of volumes and projections as R²-Gaussian defines them; the truth comes first."""

from ._core import psnr_2d, psnr_3d, ssim_2d, ssim_3d

__all__ = ["psnr_2d", "psnr_3d", "ssim_2d", "ssim_3d"]
