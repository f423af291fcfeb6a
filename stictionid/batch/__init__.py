"""Many loops: what there is to do, who does it, what is kept, and the summary that follows from what was kept.

`sources` and `peek` find loops in files, folders and datasets, `looplist` reads a list of them, `plan` makes one plain
Task of each. `worker` turns a Task into an Outcome and touches nothing else; `crew` are the executors that run it, here
or on a cluster; `drive` keeps them busy, retries once after a worker's death and hands outcomes to `store`, which
writes them whole. `summary` is rebuilt from the store alone, ordered by `rank`; `page` shows it in a browser.
"""
