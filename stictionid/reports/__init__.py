"""Reports from studies: facts and pictures once, rendered as markdown, one HTML page, JSON or terminal text.

`facts` words and rounds, `pictures` turns curves into numbers to draw, the renderers only lay out. Nothing here
searches: the model of a study is re-run once for its curves.
"""
