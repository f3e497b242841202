"""Loaders: windows of episodes, gathered in batches from a memory-mapped cache."""

from candata.loaders.augmentation import Augmentation, augment
from candata.loaders.cache import Cache, open_cache
from candata.loaders.carrying import carry_splits
from candata.loaders.feed import Windows, windows
from candata.loaders.gather import Feed, Gather, batches
from candata.loaders.increments import integrate
from candata.loaders.mixing import MixedWindows, common_channels, mix
from candata.loaders.normaliser import METHODS, Normaliser, Scale, normalise_batch
from candata.loaders.sampling import Sampler, noise
from candata.loaders.shares import Effective, Mixture, parse_mixture, share_report
from candata.loaders.simulated import SimulatedWindows
from candata.loaders.splits import Split, find_split, load_split, make_split, save_split, split_digest, split_names
from candata.loaders.tensors import as_tensors

__all__ = [
    "METHODS",
    "Augmentation",
    "Cache",
    "Effective",
    "Feed",
    "Gather",
    "MixedWindows",
    "Mixture",
    "Normaliser",
    "Sampler",
    "Scale",
    "SimulatedWindows",
    "Split",
    "Windows",
    "as_tensors",
    "augment",
    "batches",
    "carry_splits",
    "common_channels",
    "find_split",
    "integrate",
    "load_split",
    "make_split",
    "mix",
    "noise",
    "normalise_batch",
    "open_cache",
    "parse_mixture",
    "save_split",
    "share_report",
    "split_digest",
    "split_names",
    "windows",
]
