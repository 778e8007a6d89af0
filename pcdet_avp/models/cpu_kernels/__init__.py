"""The network's inner loops on a CPU, written with numba: the same answers in fewer passes over memory.

Some serve inference only, and where gradients are wanted torch's operations stand in for them; others have a backward
pass of their own. Where the tensors are not on a CPU, or not in float32, everything is torch's; that is also what the
tests compare these kernels with. All kernels release the interpreter's lock, so that two encoders can run side by side
on two threads. Everything here computes in float32. Sums over places that several threads could add to run in one
thread, in one order, so that a training is repeated bit by bit.
"""
