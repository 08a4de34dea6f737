"""The rig: relays, springs, cameras, logs, and the virtual rig that stands in for all of them."""
