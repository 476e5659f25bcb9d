"""Types of the extension module; documentation strings are in the module."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, Protocol, TypeAlias, final, overload, type_check_only

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ._types import Metric, NetworkSteps, Parameters, Population, Progress, WaveletLoss

__all__ = [
    "Activation",
    "Adam",
    "Grid",
    "Model",
    "Page",
    "Part",
    "Reconstruction",
    "Scan",
    "Scanner",
    "Sghmc",
    "adc",
    "ar",
    "asd_pocs",
    "back_project",
    "build",
    "cgls",
    "confidence",
    "command_line",
    "conformance_cases",
    "conformance_check",
    "conformance_export",
    "conformance_hunt",
    "conformance_input",
    "conformance_make",
    "conformance_open",
    "conformance_truth",
    "conformance_waivers",
    "cpu_level",
    "fdk",
    "fdk_backproject",
    "fdk_filter",
    "fdk_part",
    "footprint_gradient",
    "forward_project",
    "geometry_of",
    "gate",
    "haar",
    "haar_inverse",
    "image_loss",
    "integral_factor",
    "is_fast",
    "iterate_in",
    "kernel",
    "l1",
    "learning_rate",
    "load_scan",
    "load_volume",
    "motion_vjp",
    "nu_loss",
    "nu_target",
    "os_sart",
    "phantoms",
    "project",
    "project_vjp",
    "psnr_2d",
    "psnr_3d",
    "reconstruct",
    "restored_scan",
    "sart",
    "save_page",
    "save_volume",
    "set_max_memory",
    "set_threads",
    "show",
    "simulate",
    "ssim",
    "ssim_2d",
    "ssim_3d",
    "steps",
    "support",
    "threads",
    "total_variation",
    "truncation_bound",
    "tv",
    "voxelize",
    "voxelize_part",
    "voxelize_vjp",
    "wavelet_loss",
    "wavelet_routing",
]

@type_check_only
class SupportsArray(Protocol):
    """An array or tensor of another library."""

    def __array__(self) -> NDArray[Any]: ...

_Array: TypeAlias = NDArray[np.float32] | NDArray[np.float64]
_Views: TypeAlias = NDArray[Any] | Sequence[float] | SupportsArray
_Numbers: TypeAlias = NDArray[np.float64] | Sequence[float]
_Path: TypeAlias = str | PathLike[str]
_Projection: TypeAlias = Literal["exact", "affine"]
_Rays: TypeAlias = Literal["joseph", "siddon"]
_Window: TypeAlias = Literal["ram-lak", "shepp-logan", "cosine", "hamming", "hann"]
_Order: TypeAlias = Literal["input", "random", "angular-distance"]
_Method: TypeAlias = Literal[
    "tr-gs", "r2-gaussian", "fdk", "sart", "os-sart", "asd-pocs", "cgls", "tv", "naf", "sax-nerf", "intratomo"
]
_Callback: TypeAlias = Callable[[Progress], object]
_Five: TypeAlias = Parameters | Sequence[_Array]
_Triple: TypeAlias = tuple[float, float, float]
_Counts: TypeAlias = tuple[int, int, int]

@final
class Grid:
    def __new__(cls, shape: _Counts, low: _Triple = ..., high: _Triple = ...) -> Grid: ...
    @property
    def shape(self) -> _Counts: ...
    @property
    def low(self) -> _Triple: ...
    @property
    def high(self) -> _Triple: ...
    @property
    def spacing(self) -> _Triple: ...
    def block(self, start: _Counts, shape: _Counts) -> Grid: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Scanner:
    @staticmethod
    def cone(
        dso: float,
        dsd: float,
        *,
        detector: tuple[int, int],
        pitch: tuple[float, float],
        grid: Grid,
        offset: tuple[float, float] = ...,
    ) -> Scanner: ...
    @staticmethod
    def parallel(
        *, detector: tuple[int, int], pitch: tuple[float, float], grid: Grid, offset: tuple[float, float] = ...
    ) -> Scanner: ...
    @staticmethod
    def from_vectors(vectors: _Views, *, detector: tuple[int, int], grid: Grid) -> Scanner: ...
    @staticmethod
    def synthetic(voxels: int, pixels: int) -> Scanner: ...
    @staticmethod
    def read(path: _Path) -> Scanner: ...
    @staticmethod
    def parse(text: str) -> Scanner: ...
    @staticmethod
    def uniform_angles(views: int, start: float = 0.0, span: float = ...) -> list[float]: ...
    @property
    def beam(self) -> Literal["cone", "parallel"]: ...
    @property
    def dso(self) -> float | None: ...
    @property
    def dsd(self) -> float | None: ...
    @property
    def detector(self) -> tuple[int, int]: ...
    @property
    def pitch(self) -> tuple[float, float]: ...
    @property
    def offset(self) -> tuple[float, float]: ...
    @property
    def grid(self) -> Grid: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Model:
    def __new__(cls, mean: _Array, scale: _Array, quaternion: _Array, density: _Array, nu: _Array) -> Model: ...
    @staticmethod
    def load(path: _Path) -> Model: ...
    def save(self, path: _Path) -> None: ...
    @property
    def mean(self) -> NDArray[np.float64]: ...
    @property
    def scale(self) -> NDArray[np.float64]: ...
    @property
    def quaternion(self) -> NDArray[np.float64]: ...
    @property
    def density(self) -> NDArray[np.float64]: ...
    @property
    def nu(self) -> NDArray[np.float64]: ...
    @property
    def kernel(self) -> Literal["student-t", "gaussian"]: ...
    def covariance(self) -> NDArray[np.float64]: ...
    def __len__(self) -> int: ...

@final
class Scan:
    def __new__(
        cls,
        scanner: Scanner,
        angles: _Views,
        projections: NDArray[np.float32],
        *,
        truth: NDArray[np.float32] | None = None,
        test_angles: _Views | None = None,
        test_projections: NDArray[np.float32] | None = None,
        name: str = "scan",
    ) -> Scan: ...
    @property
    def name(self) -> str: ...
    @property
    def scanner(self) -> Scanner: ...
    @property
    def scale(self) -> float: ...
    @property
    def unit(self) -> str | None: ...
    @property
    def place(self) -> tuple[list[float], list[float], list[list[float]]]: ...
    @property
    def angles(self) -> NDArray[np.float64]: ...
    @property
    def poses(self) -> NDArray[np.float64] | None: ...
    @property
    def test_poses(self) -> NDArray[np.float64] | None: ...
    @property
    def projections(self) -> NDArray[np.float32]: ...
    @property
    def test_angles(self) -> NDArray[np.float64] | None: ...
    @property
    def test_projections(self) -> NDArray[np.float32] | None: ...
    @property
    def truth(self) -> NDArray[np.float32] | None: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def oddities(self) -> list[str]: ...
    @property
    def remarks(self) -> list[str]: ...
    def correct(
        self,
        *,
        air: Literal["auto"] | float | None = None,
        mask_pixels: Literal["auto"] | NDArray[np.bool_] | None = None,
    ) -> Scan: ...
    def save(self, folder: _Path) -> None: ...
    def evaluate(self, volume: NDArray[np.float32], model: Model | None = None) -> dict[str, Metric]: ...
    def __len__(self) -> int: ...

@final
class Reconstruction:
    @property
    def volume(self) -> NDArray[np.float32]: ...
    @property
    def model(self) -> Model | None: ...
    @property
    def unfinished(self) -> NDArray[np.float32] | None: ...
    @property
    def log(self) -> list[dict[str, Any]]: ...
    @property
    def choice(self) -> dict[str, Any] | None: ...
    @property
    def unit(self) -> float | None: ...
    @property
    def settings(self) -> str: ...
    @property
    def grid(self) -> Grid: ...
    def save(self, path: _Path) -> None: ...

@final
class Activation:
    def __new__(
        cls,
        scale_range: tuple[float, float],
        nu_range: tuple[float, float] = ...,
        kernel: Literal["student-t", "gaussian"] = "student-t",
    ) -> Activation: ...
    def forward(self, raw: _Five) -> Model: ...
    def inverse(self, model: Model) -> Parameters: ...
    def vjp(self, model: Model, gradient: _Five) -> Parameters: ...

@final
class Adam:
    def __new__(cls, n: int, beta: tuple[float, float] = ..., epsilon: float = 1e-15) -> Adam: ...
    def step(self, parameters: NDArray[np.float64], gradient: NDArray[np.float64], rate: float) -> None: ...
    def direction(self, gradient: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def remap_rows(self, width: int, rows: Sequence[int | None]) -> None: ...

@final
class Sghmc:
    def __new__(cls, m: int) -> Sghmc: ...
    def step(
        self,
        positions: NDArray[np.float64],
        direction: NDArray[np.float64],
        *,
        rate: float,
        friction: float,
        gate: NDArray[np.float64],
        noise: NDArray[np.float64],
        covariance: NDArray[np.float64] | None = None,
    ) -> None: ...

def set_max_memory(size: int | None = None) -> None: ...
def set_threads(n: int) -> None: ...
def threads() -> int: ...
def build() -> list[tuple[str, str]]: ...
def command_line(arguments: list[str]) -> int: ...
def cpu_level() -> Literal["baseline", "v3", "v4"]: ...
def is_fast() -> bool: ...
def kernel(delta: _Numbers, nu: _Numbers, *, dtype: DTypeLike | None = None) -> _Array: ...
def integral_factor(nu: _Numbers) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def confidence(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    *,
    sphere_points: int = 512,
    r_max: float = 0.5,
    kappa: float = 1.0,
    alpha: Literal["own", "median"] | float = "own",
) -> NDArray[np.float64]: ...
def nu_target(
    confidence: _Numbers,
    *,
    nu_range: tuple[float, float] = ...,
    sphere_points: int = 512,
    temperature: float = 0.25,
) -> NDArray[np.float64]: ...
def nu_loss(
    nu: _Numbers, target: _Numbers, confidence: _Numbers, weight: float
) -> tuple[float, NDArray[np.float64]]: ...
def project(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    *,
    projection: _Projection = "exact",
    cutoff: float = 0.0,
    dtype: DTypeLike | None = None,
) -> _Array: ...
def project_vjp(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    cotangent: _Array,
    *,
    projection: _Projection = "exact",
    cutoff: float = 0.0,
) -> Parameters: ...
def motion_vjp(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    cotangent: _Array,
    *,
    projection: _Projection = "exact",
    cutoff: float = 0.0,
) -> NDArray[np.float64]: ...
def geometry_of(text: str, angles: _Views) -> tuple[Scanner, NDArray[np.float64], float]: ...
def restored_scan(scanner: Scanner, arrays: Any, labels: Any, place: Any, words: Any) -> Scan: ...
def footprint_gradient(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    cotangent: _Array,
    *,
    projection: _Projection = "exact",
    cutoff: float = 0.0,
) -> NDArray[np.float64]: ...
def support(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    *,
    projection: _Projection = "exact",
    cutoff: float = 0.0,
) -> NDArray[np.float64]: ...
def truncation_bound(
    model: Model,
    scanner: Scanner,
    angles: _Views,
    *,
    projection: _Projection = "exact",
    cutoff: float = 1e-3,
) -> NDArray[np.float64]: ...
def voxelize(
    model: Model, grid: Grid | Scanner, *, cutoff: float = 0.0, dtype: DTypeLike | None = None
) -> _Array: ...
def voxelize_part(
    model: Model, grid: Grid | Scanner, cutoff: float, dtype: DTypeLike | None, slices: tuple[int, int]
) -> _Array: ...
def voxelize_vjp(model: Model, grid: Grid | Scanner, cotangent: _Array, *, cutoff: float = 0.0) -> Parameters: ...
def l1(prediction: _Array, target: _Array) -> tuple[float, _Array]: ...
def ssim(prediction: _Array, target: _Array) -> tuple[float, _Array]: ...
def image_loss(prediction: _Array, target: _Array, weight: float = 0.25) -> tuple[float, _Array]: ...
def total_variation(block: _Array) -> tuple[float, _Array]: ...
def haar(block: _Array, levels: int = 1) -> list[_Array]: ...
def haar_inverse(levels: Sequence[_Array]) -> _Array: ...
def wavelet_routing(
    grid: Grid | Scanner,
    means: NDArray[np.float64],
    confidence: NDArray[np.float64],
    *,
    neighbours: int = 8,
    threshold: float = 0.35,
) -> NDArray[np.uint16]: ...
def wavelet_loss(
    block: _Array,
    high: NDArray[np.uint16],
    *,
    neighbours: int = 8,
    enhancement: float = 1.5,
    suppress: float = 0.03,
    enhance: float = 0.01,
    levels: int = 1,
) -> WaveletLoss: ...
def psnr_3d(truth: NDArray[np.float32], result: NDArray[np.float32]) -> Metric: ...
def ssim_3d(truth: NDArray[np.float32], result: NDArray[np.float32]) -> Metric: ...
def psnr_2d(truth: NDArray[np.float32], result: NDArray[np.float32]) -> Metric: ...
def ssim_2d(truth: NDArray[np.float32], result: NDArray[np.float32]) -> Metric: ...
def gate(density: _Numbers, reference: float) -> NDArray[np.float64]: ...
def learning_rate(step: int, first: float, last: float, length: int) -> float: ...
def ar(
    model: Model,
    uniform: _Numbers,
    *,
    dead: float,
    recycled: float,
    growth: float,
    cap: int,
    relocation: Literal["exact", "sss", "sss-program"] = "exact",
) -> Population: ...
def steps(
    scan: Scan, method: Literal["naf", "sax-nerf", "intratomo"] = "naf", *, steps: int = 10, **settings: Any
) -> NetworkSteps: ...
def adc(
    model: Model,
    pull: NDArray[np.float64],
    normals: NDArray[np.float64],
    *,
    gradient: float,
    split_scale: float,
    faint: float,
    cap: int,
    low: _Numbers,
    high: _Numbers,
) -> Population: ...
def forward_project(volume: _Array, scanner: Scanner, angles: _Views, *, rays: _Rays = "joseph") -> _Array: ...
def back_project(projections: _Array, scanner: Scanner, angles: _Views, *, rays: _Rays = "joseph") -> _Array: ...
def fdk_filter(projections: _Array, scanner: Scanner, angles: _Views, *, window: _Window = "ram-lak") -> _Array: ...
def fdk_backproject(filtered: _Array, scanner: Scanner, angles: _Views) -> _Array: ...
def fdk(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    *,
    window: _Window = "ram-lak",
    turn: Literal["measured", "full"] = "measured",
) -> NDArray[np.float32]: ...
def sart(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    *,
    iterations: int = 20,
    relaxation: float = 1.0,
    reduction: float = 0.999,
    order: _Order = "input",
    non_negative: bool = True,
    tolerance: float = 0.0,
    seed: int = 0,
    rays: _Rays = "joseph",
    dtype: DTypeLike | None = None,
    callback: _Callback | None = None,
) -> NDArray[np.float32]: ...
def os_sart(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    *,
    subset: int = 10,
    iterations: int = 20,
    relaxation: float = 1.0,
    reduction: float = 0.999,
    order: _Order = "input",
    non_negative: bool = True,
    tolerance: float = 0.0,
    seed: int = 0,
    rays: _Rays = "joseph",
    dtype: DTypeLike | None = None,
    callback: _Callback | None = None,
) -> NDArray[np.float32]: ...
def asd_pocs(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    *,
    iterations: int = 10,
    tv_steps: int = 20,
    alpha: float = 0.002,
    alpha_reduction: float = 0.95,
    r_max: float = 0.94,
    epsilon: float = 0.15,
    unit: float = 1.0,
    relaxation: float = 1.0,
    reduction: float = 0.9999,
    rays: _Rays = "joseph",
    dtype: DTypeLike | None = None,
    callback: _Callback | None = None,
) -> NDArray[np.float32]: ...
def cgls(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    *,
    iterations: int = 20,
    rays: _Rays = "joseph",
    dtype: DTypeLike | None = None,
    callback: _Callback | None = None,
) -> NDArray[np.float32]: ...
def tv(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    *,
    weight: float = 1e-3,
    iterations: int = 40,
    tolerance: float = 1e-4,
    steps: int = 10,
    rays: _Rays = "joseph",
    dtype: DTypeLike | None = None,
    callback: _Callback | None = None,
) -> NDArray[np.float32]: ...
def phantoms() -> list[str]: ...
def simulate(
    object: str | NDArray[np.float32],
    scanner: Scanner,
    views: int,
    *,
    test_views: int = 0,
    noise: str = "none",
    seed: int = 0,
    rays: Literal["trilinear", "siddon", "joseph"] = "trilinear",
) -> Scan: ...
def load_scan(path: _Path) -> Scan: ...
@overload
def load_volume(path: _Path, *, scan: Scan | None = None, place: Literal[False] = False) -> NDArray[np.float32]: ...
@overload
def load_volume(
    path: _Path, *, scan: Scan | None = None, place: Literal[True]
) -> tuple[NDArray[np.float32], dict[str, Any]]: ...
def save_volume(path: _Path, volume: NDArray[np.float32], grid: Scan | Grid | Scanner) -> None: ...
@final
class Page:
    @property
    def html(self) -> str: ...
    def save(self, path: _Path) -> None: ...
    def _repr_html_(self) -> str: ...

def show(
    volumes: NDArray[np.float32] | dict[str, NDArray[np.float32]],
    grid: Scan | Grid | Scanner | None = None,
    *,
    title: str = "volume",
    full: bool = False,
    mu_water: float | None = None,
) -> Page: ...
def save_page(
    path: _Path,
    volumes: NDArray[np.float32] | dict[str, NDArray[np.float32]],
    grid: Scan | Grid | Scanner | None = None,
    *,
    title: str = "volume",
    full: bool = False,
    mu_water: float | None = None,
) -> None: ...
def reconstruct(
    scan: Scan,
    method: _Method = "tr-gs",
    settings: dict[str, Any] | None = None,
    *,
    progress: bool = False,
    callback: _Callback | None = None,
    checkpoint: _Path | None = None,
    **more: object,
) -> Reconstruction: ...
def conformance_cases(stages: Sequence[str], level: str) -> str: ...
def conformance_input(id: str, role: str) -> Any: ...
def conformance_open(folder: _Path) -> None: ...
def conformance_truth(id: str, role: str) -> Any: ...
def conformance_waivers(file: _Path) -> str: ...
def conformance_check(
    id: str, outputs: dict[str, dict[str, NDArray[np.float64]]], precision: str, folder: _Path | None
) -> str: ...
def conformance_make(folder: _Path, stages: Sequence[str], seed: int, count: int, level: str) -> int: ...
def conformance_hunt(
    backend: Callable[[Any, Any], str | None],
    folder: _Path,
    stages: Sequence[str],
    seed: int,
    cases: int,
    seconds: float | None,
    precision: str,
    level: str,
    ask: str,
) -> str: ...
def conformance_export(folder: _Path, stages: Sequence[str], level: str, blind: bool) -> int: ...

@final
class Part:
    def __new__(cls, scanner: Scanner, angles: _Views, first: int, last: int) -> Part: ...
    def reads(self, steps: int) -> tuple[int, int]: ...
    def project(
        self, views: Sequence[int], slab: NDArray[np.float32] | None, rising: bool, sums: NDArray[np.float32]
    ) -> NDArray[np.float32]: ...
    def complete(self, views: Sequence[int], sums: NDArray[np.float32]) -> NDArray[np.float32]: ...
    def adjoin(
        self, views: Sequence[int], images: NDArray[np.float32], slab: NDArray[np.float32], step: float | None
    ) -> NDArray[np.float32]: ...
    def correct(
        self,
        views: Sequence[int],
        corrections: NDArray[np.float32],
        weights: NDArray[np.float32],
        slab: NDArray[np.float32],
        relaxation: float,
        non_negative: bool,
    ) -> NDArray[np.float32]: ...
    def measure(self, what: str, beta: float, volumes: Sequence[NDArray[np.float32]]) -> list[list[float]]: ...
    def solve(
        self,
        y: NDArray[np.float32],
        dual: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
        tau: float,
        steps: int,
    ) -> tuple[NDArray[np.float32], list[NDArray[np.float32]]]: ...

def fdk_part(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    window: str,
    turn: str,
    slices: tuple[int, int],
) -> NDArray[np.float32]: ...
def iterate_in(
    projections: NDArray[np.float32],
    scanner: Scanner,
    angles: _Views,
    space: Any,
    method: str,
    settings: Sequence[str],
    callback: Callable[[Progress], object] | None = None,
) -> None: ...
