"""Fields from tracked points: displacement gradients, strain, medians over the contact, and standard deviations."""
