"""Grippers: the protocol, its two kinds, and their contact with the parts.

solids                  triangle meshes of the shapes of robots, tools and obstacles
contact                 the held part, or the reason why no part is held
jaw_tool, suction_tool  the two kinds: settings, and the methods of the protocol
tools                   the protocol, and the kinds of tool in a configuration
touch                   the true contact of a tool at its target
"""
