"""Pictures of estimates, for people: matplotlib, drawn off screen, loaded when something is drawn.

`orientation.draw(path, ...)` draws one sensor's roll, pitch and heading with their 95 % bands, and the error where the
truth is known; `joints.draw(path, ...)` joint angles with theirs. Needs `pip install 'jaxest[viz]'`.
`jaxest.viz.animation.draw` renders a moving robot through MuJoCo (GIF, PNG), `jaxest.viz.recording.write` makes a 3-D
recording for the Rerun viewer (`pip install 'jaxest[rerun]'`); `jaxest show` calls both.

Not here: tables and progress bars, which are the command line's.
"""

from jaxest.viz import joints, orientation

__all__ = ["joints", "orientation"]
