"""Drives planned trajectories through PhysX and finds out whether they would have worked.

Needs `pip install 'akrobat[physics]'`; no Vulkan driver, because nothing is drawn.
"""

from akrobat.physics.audit import EpisodeAudit
from akrobat.physics.config import PhysicsConfig
from akrobat.physics.replay import Replayer, replay
from akrobat.physics.world import World

__all__ = ["EpisodeAudit", "PhysicsConfig", "Replayer", "World", "replay"]
