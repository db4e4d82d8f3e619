"""The run folder: what a sweep leaves on disk, its tables, and the statistics of them."""
