"""
Which measure do participants feel?
===================================

In each trial a participant feels two plates and says which one is more slippery. A measure that tells right answers
from wrong ones has a large d' and an area under the ROC curve above one half.
"""

import matplotlib.pyplot as plt
import numpy as np

from fingerflow.models.observer.discrimination import auc, d_prime

draw = np.random.default_rng(0)
participant = np.repeat(np.arange(10), 40)
divergence = draw.normal(8, 4, 400)  # µm/mm between the two plates
answers = divergence + draw.normal(0, 4, 400) > 5  # the participant feels it with noise, and has a criterion
felt, missed = divergence[answers], divergence[~answers]
area = draw.normal(20, 6, 400)  # a measure that nobody feels

# %%
# Intervals of 95 %, participants as units. That of the felt measure excludes chance (0 and 0.5), that of the other does
# not.

for name, metric in (("divergence", divergence), ("contact area", area)):
    trials = metric[answers], metric[~answers], (participant[answers], participant[~answers])
    sensitivity, under_roc = (of(*trials) for of in (d_prime, auc))
    low, high = under_roc.interval
    print(f"{name}: d' {sensitivity.value:.2f}, area under the ROC {under_roc.value:.2f} ({low:.2f} to {high:.2f})")
    assert (low > 0.5) == (name == "divergence")

_, axes = plt.subplots(figsize=(4.5, 3), layout="constrained")
axes.hist((felt, missed), bins=20, label=("answered: more slippery", "answered: not"))
axes.set(xlabel="difference of divergence (µm/mm)", ylabel="trials")
axes.legend()
