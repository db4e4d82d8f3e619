"""GPU kernels of functions of many worlds or runs, through Pallas and Triton."""
