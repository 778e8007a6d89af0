"""The network's inner loops for inference on a CPU, written with numba: the same answers in fewer passes over memory.

Where gradients are wanted, or the tensors are not on a CPU, the modules use torch's operations as before; those are
also what the tests compare these kernels with. All kernels release the interpreter's lock, so that two encoders can
run side by side on two threads. Everything here computes in float32.
"""
