"""Fields of a truth that say how a case was made."""

# Origins of the equation that makes a hidden effect, {name: description}
EQUATIONS = {
    "simulator": "the simulator's own",
    "other": "another equation than the library's",
    "own": "the library's equation, written again",
}
