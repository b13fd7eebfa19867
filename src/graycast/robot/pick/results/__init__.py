"""The results of picking: their folder, runs over many bins, and summaries.

pick_files  a folder with the completed bins of one cell and one seed
pick_run    runs over many bins in worker processes
summary     rates with intervals, outcomes, times, paired comparisons, and plots
replay      data for the animation of a folder of picks
"""
