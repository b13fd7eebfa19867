"""The cell of a robot, and the sequence of picks from one bin.

pick_sections, robot_cell  settings of the cell, and the cell with its files
aim, clock                 candidate grips on detected parts; computing time by stage
bin_scan                   one scan of the bin
ready                      the prepared cell: arm, tool, rigid bodies, known grips, detector
choose, carry              the choice of a grip, and its execution
episode                    one bin, from its filling until no part can be picked
"""
