"""Loaders: windows of episodes, gathered in batches from a memory-mapped cache."""

from candata.loaders.cache import Cache, open_cache
from candata.loaders.feed import Windows, windows
from candata.loaders.increments import integrate
from candata.loaders.normaliser import Normaliser, Scale
from candata.loaders.sampling import Sampler
from candata.loaders.splits import Split, find_split, load_split, make_split, save_split, split_digest, split_names
from candata.loaders.tensors import as_tensors

__all__ = [
    "Cache",
    "Normaliser",
    "Sampler",
    "Scale",
    "Split",
    "Windows",
    "as_tensors",
    "find_split",
    "integrate",
    "load_split",
    "make_split",
    "open_cache",
    "save_split",
    "split_digest",
    "split_names",
    "windows",
]
