"""The proof: recordings of an independent simulator in which physics is concealed, the diagnosis of them, the score.

Nothing here that makes recordings uses the library's own physics, projectors or solvers, and nothing of the diagnosis
imports this package.
"""
