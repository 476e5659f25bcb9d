"""Single steps of the optimisers, learning rates, and the map between raw and physical parameters."""

from ._core import Activation, Adam, Sghmc, gate, learning_rate

__all__ = ["Activation", "Adam", "Sghmc", "gate", "learning_rate"]
