"""Pictures of estimates, for people: matplotlib, drawn off screen, loaded when something is drawn.

`orientation.draw(path, ...)` draws one sensor's roll, pitch and heading with their 95 % bands, and the error where the
truth is known; `joints.draw(path, ...)` joint angles with theirs. Needs `pip install 'jaxest[viz]'`.

Not here: tables and progress bars, which are the command line's; 3-D scenes.
"""

from jaxest.viz import joints, orientation

__all__ = ["joints", "orientation"]
