"""Gymnasium environments, such as `akrobat.env:akrobat/OpenObject-v0`.

Needs `pip install 'akrobat[physics]'`. Gymnasium imports what stands before the colon, which
registers the environments; after `import akrobat.env` the name alone is enough.
"""

import gymnasium

from akrobat.env.open_object import OpenObjectEnv

__all__ = ["OpenObjectEnv"]

gymnasium.register("akrobat/OpenObject-v0", entry_point="akrobat.env:OpenObjectEnv")
