"""ROS 2 nodes of a rig: they translate messages; every decision is made by the toolkit below.

`nodes` holds the seven nodes, `programs` what starts them, `base` what they share.
"""
