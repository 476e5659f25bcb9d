"""backend.py with the products of tensor cores: factors of 11 bits, sums in float32, forward and backward.

    python3 products.py VECTORS ANSWERS
"""
import sys
from pathlib import Path

import torch
from torch.overrides import TorchFunctionMode

sys.argv[3:] = ["float32"]
import backend  # noqa: E402  it reads the precision when it is imported

PRODUCTS = {torch.matmul, torch.bmm, torch.mm, torch.Tensor.matmul, torch.Tensor.__matmul__}


def rounded(x):
    fraction, exponent = torch.frexp(x)
    return torch.ldexp(torch.round(fraction * 2048) / 2048, exponent)


class Rounded(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        return rounded(x)

    @staticmethod
    def backward(ctx, slope):
        return slope


class Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, a, b):
        ctx.save_for_backward(a, b)
        return rounded(a) @ rounded(b)

    @staticmethod
    def backward(ctx, slope):
        a, b = map(rounded, ctx.saved_tensors)
        of_a, of_b = rounded(slope) @ b.mT, a.mT @ rounded(slope)
        return of_a.sum_to_size(a.shape), of_b.sum_to_size(b.shape)


class TensorCores(TorchFunctionMode):
    def __torch_function__(self, function, types, args=(), kwargs=None):
        if function is torch.einsum:
            return function(args[0], *map(Rounded.apply, args[1:]))
        if function in PRODUCTS and min(factor.dim() for factor in args) > 1:
            return Product.apply(*args)
        if function in PRODUCTS:
            return function(*map(Rounded.apply, args))
        return function(*args, **(kwargs or {}))


with TensorCores():
    backend.main(*map(Path, sys.argv[1:3]))
