"""Pipeline from experiment settings to a labelled data set: plan, run, and reuse of an earlier result."""
