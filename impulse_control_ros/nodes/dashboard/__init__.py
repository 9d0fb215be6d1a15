"""
A page in the browser that shows a run and tunes its nodes.

The page has BokehJS for its curves, and native form fields for the parameters: they are reached by
the keyboard and read by a phone or a screen reader without code of ours. Bokeh's wheel contains
BokehJS, so the page works offline. Its own server (``bokeh serve``) is not used: it keeps a Python
document for each browser window, which is lost with the connection. Ours is tornado, on which
Bokeh's is built, and keeps nothing for a window but what it has been sent.
"""
