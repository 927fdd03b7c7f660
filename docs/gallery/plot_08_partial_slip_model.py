"""
When does a contact let go at once?
===================================

Equation 5 of Terekhov & Hayward (2011): with a kinetic friction below the static one the stuck area vanishes from a
critical size; otherwise it fades to nothing.
"""

import matplotlib.pyplot as plt
import torch

from fingerflow.models import partial_slip

load = torch.linspace(0, 0.8, 400, dtype=torch.float64)
_, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for mu_s, mu_k in ((0.8, 0.4), (0.6, 0.6), (0.5, 0.7)):
    axes.plot(load, partial_slip.stuck_area(load, mu_s, mu_k), label=f"static {mu_s}, kinetic {mu_k}")
axes.set(xlabel="T/N", ylabel="stuck share of the contact, d²")
axes.legend()

critical = partial_slip.critical_stuck_area(0.8, 0.4)
print(f"critical size {float(critical):.3f} for friction 0.8 and 0.4")
assert torch.isclose(partial_slip.friction_ratio(critical), torch.tensor(0.5, dtype=torch.float64))
