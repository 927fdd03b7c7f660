"""Speed against error: this project beside its peers, in one process on the same cores."""
