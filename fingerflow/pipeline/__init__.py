"""From a scene to a labelled data set: the plan, the run, and what an earlier result still holds."""
