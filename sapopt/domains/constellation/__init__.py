"""Satellite constellations observing tasks on the ground (chapters 4 and 6 of Holder 2024)."""

from sapopt.domains.constellation.elements import (
    ElementSets,
    element_positions_km,
    read_elements,
    starlink_elements,
)
from sapopt.domains.constellation.graphs import linked_pairs, links
from sapopt.domains.constellation.orbits import (
    STARLINK_SHELLS,
    STARLINK_SHELLS_2019,
    STARLINK_SHELLS_4225,
    WalkerShell,
    walker_positions_km,
)
from sapopt.domains.constellation.scenario import (
    Constellation,
    constellation,
    element_constellation,
    walker_constellation,
)
from sapopt.domains.constellation.tasks import GroundTasks, even_tasks, random_tasks, ring_tasks
from sapopt.domains.constellation.view import FieldOfView, visible_benefits

__all__ = [
    "STARLINK_SHELLS",
    "STARLINK_SHELLS_2019",
    "STARLINK_SHELLS_4225",
    "Constellation",
    "ElementSets",
    "FieldOfView",
    "GroundTasks",
    "WalkerShell",
    "constellation",
    "element_constellation",
    "element_positions_km",
    "even_tasks",
    "linked_pairs",
    "links",
    "random_tasks",
    "read_elements",
    "ring_tasks",
    "starlink_elements",
    "visible_benefits",
    "walker_constellation",
    "walker_positions_km",
]
