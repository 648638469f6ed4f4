"""Learning of value functions: data collection, temporal differences, training."""

from .collect import CollectOptions as CollectOptions
from .options import LearnOptions as LearnOptions
from .train import train_value as train_value
