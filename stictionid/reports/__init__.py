"""Reports of studies as markdown, HTML, JSON or terminal text, all from the same facts and pictures.

`facts` words and rounds, `pictures` turns curves into numbers to draw, the renderers in `pages` lay out. Imports run
one way: pages use pictures and words, pictures use words. Nothing here searches: the model of a study is re-run once
for its curves.
"""
