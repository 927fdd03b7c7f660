"""Format number of bundles, increased whenever a player of another version cannot play them."""

BUNDLE_FORMAT = 6
