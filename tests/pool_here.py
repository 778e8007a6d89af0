"""Stands for Dask's pool where a test is not about processes."""


class PoolHere:
    """One job at a time, in this process; ``choose`` says which of those that wait is next."""

    def __init__(self, function, choose=lambda waiting: waiting[0]):
        self.function, self.choose, self.waiting = function, choose, []

    def submit(self, job, priority=0):
        self.waiting.append(job)

    def results(self):
        while self.waiting:
            job = self.choose(self.waiting)
            self.waiting.remove(job)
            yield self.function(job)
