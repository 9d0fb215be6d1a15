"""
A page in the browser that shows a run and tunes its nodes.

The page uses BokehJS for its plots and native form controls for the parameters, so it works with
the keyboard, on a phone and with a screen reader without code of ours. Bokeh's wheel contains
BokehJS, so the page works offline. ``bokeh serve`` is not used: it keeps a Python document for
each browser window, which is lost with the connection. The server of the dashboard is tornado, on
which Bokeh's is built. For each window it only keeps what it has sent.
"""
