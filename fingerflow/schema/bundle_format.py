"""The format of bundles, raised where a player of another version could not play them."""

BUNDLE_FORMAT = 6
