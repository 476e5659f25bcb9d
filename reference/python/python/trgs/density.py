"""Single steps of density control: adding and recycling, and adaptive density control."""

from ._core import adc, ar

__all__ = ["adc", "ar"]
