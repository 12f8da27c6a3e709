"""The scoring rule in words, which a registration states before the scans."""

from __future__ import annotations

from ...base.names import label
from ..hiding.missing_effects import OF_OBJECT

LEAST_IN_CLASS = 5  # scores in a class that can be the worst one: fewer would only show chance
# Version 1 of the rule had no shares for groups, and counted own equations with the others. Version 2 had no
# significance. For version 3, another object was a wrong answer to faults of the object.
VERSION = 4
RULE = (
    "One effect: the score is 1 if it was ranked first, and 1/k if it is in the first group of k effects that "
    "were reported as equal. Two effects: each must be in a separate group, and the score is the product of "
    "1/k. Precisely right: one or two hidden effects, all of them and no others were named, none in a group. "
    "False alarm: nothing is hidden, but the verdict is not a match (nothing, or nothing relevant, is missing). "
    "Effects named beside a match count only if a weak effect is hidden. A fault that the library lacks must be "
    "reported as unexplained, unless precisely an equivalent that was declared before the run was named. A fault of "
    f"the object ({', '.join(map(label, OF_OBJECT))}) may also be reported as another object. Intervals: "
    "comparable parameters of named hidden effects. Cases with an effect that the library's own equation makes are "
    "counted separately. The worst class is the simulator, geometry, object or hidden effect with the worst share "
    f"of at least {LEAST_IN_CLASS} scores. All cases count. All quantities are also stated by significance: effects "
    "named beside a match then count for any strength, and with them a match is none."
)
