"""Loads what workers need, in the process that they are forked from.

Loading makes no garbage, and searching for it takes a quarter of the time. Afterwards nothing of what is loaded is
searched again, and no worker has a copy of it for that.
"""

import gc
from importlib import import_module

gc.disable()
for _name in ("distributed", "fingerflow.study.trial"):
    import_module(_name)
gc.freeze()
gc.enable()
