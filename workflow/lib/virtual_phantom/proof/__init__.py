"""The blind validation: an independent simulator hides physics, the diagnosis runs, and the result is scored.

Modules that make recordings use none of Virtual Phantom's physics, projectors or solvers. No module of the diagnosis
imports this package.
"""
