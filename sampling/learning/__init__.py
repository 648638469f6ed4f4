"""Learning of value functions: collection of data, learning by temporal differences, and both in one call."""

from .collect import CollectOptions as CollectOptions
from .options import LearnOptions as LearnOptions
from .train import train_value as train_value
