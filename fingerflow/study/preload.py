"""Modules that are imported once, in the process from which workers are forked.

Importing creates no garbage, and searching for it takes a quarter of the time. The garbage collector is therefore off
during the imports. Afterwards the imported objects are frozen: they are not searched again and stay shared in memory.
"""

import gc
from importlib import import_module

gc.disable()
for _name in ("distributed", "fingerflow.study.trial"):
    import_module(_name)
gc.freeze()
gc.enable()
