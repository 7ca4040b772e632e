"""Tracking objects over the contiguous United States from satellites (Holder 2024, section 4.3)."""

from sapopt.domains.tracking.objects import Objects, moving_objects
from sapopt.domains.tracking.regions import Regions, us_regions
from sapopt.domains.tracking.scenario import Tracking, tracking, tracking_thesis

__all__ = ["Objects", "Regions", "Tracking", "moving_objects", "tracking", "tracking_thesis", "us_regions"]
