"""Batch of many loops: tasks, workers, an output folder, and a summary made from that folder.

`plan` finds loops in files, folders, datasets and loop lists, and makes one plain Task of each. `work/worker` turns a
Task into an outcome and touches nothing else. `work/crew` holds the executors that run it, local or on a cluster.
`work/drive` keeps them busy, retries once after a worker's death and passes outcomes to `work/store`, which writes them
whole. `summary` is rebuilt from the store alone, by `summary/rows`; `summary/page` shows it in a browser and writes
its files.
"""
