"""
What does friction do to the skin?
==================================

The skin chain of Willemet et al. (2021) is pressed on plates of different friction: no images, float64. Friction holds
skin back, so more friction means less divergence.
"""

import matplotlib.pyplot as plt
import torch

from fingerflow.models import half_space, skin_chain

frictions = torch.logspace(-2, 0, 13, dtype=torch.float64)
pressed = skin_chain.press(frictions, load_n=3.0, elements=101)  # all presses at once
assert (pressed.divergence.diff() < 0).all()
assert (pressed.balance < 1e-4).all()  # N, the sum of all forces that are not balanced

_, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.semilogx(frictions, 1e3 * pressed.divergence, ".-")
axes.set(xlabel="coefficient of friction", ylabel="median divergence at 3 N (µm/mm)")

# %%
# Stress 2 mm under the surface, where the receptors are. It hardly depends on friction above 0.1, as all skin sticks.

y = torch.linspace(-6e-3, 6e-3, 121, dtype=torch.float64)
_, _, tau_yz = half_space.stress(y, 2e-3, *pressed.strips())

_, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for k in (0, 4, 12):
    axes.plot(1e3 * y, 1e-3 * tau_yz[k], label=f"friction {frictions[k]:.2f}")
axes.set(xlabel="along the glass (mm)", ylabel="shear stress (kPa)")
axes.legend()

# %%
# How divergence depends on friction, by a difference quotient: presses of one batch take little longer than one press.

steps = torch.tensor([-1e-2, -1e-3, 1e-3, 1e-2], dtype=torch.float64)
divergence = skin_chain.press(0.3 + steps, load_n=3.0, elements=101).divergence
wide, narrow = (float((divergence[-k] - divergence[k - 1]) / (steps[-k] - steps[k - 1])) for k in (1, 2))
print(f"slope at 0.3: {1e3 * narrow:.1f} µm/mm, over a ten times wider step {1e3 * wide:.1f}")
assert narrow < 0
assert abs(wide / narrow - 1) < 0.05
