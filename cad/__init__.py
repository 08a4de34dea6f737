"""From a design to a packet that a workshop can print: build filter, parts, plates, packet."""
