"""Training steps of the methods that are networks: NAF, SAX-NeRF and IntraTomo, for programs that repeat them."""

from ._core import steps
from ._types import Batch, NetworkSteps

__all__ = ["Batch", "NetworkSteps", "steps"]
