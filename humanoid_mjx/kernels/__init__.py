"""Compiler from functions of one world to kernels of many: LLVM's on a CPU, Triton's on a GPU (`docs/kernels.md`)."""
