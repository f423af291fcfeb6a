"""The Python interface: loops from DataFrames, studies with tables and pictures, and one function per verb.

`import stictionid as st` gives every name on first use. A file here wraps a frozen record of `record/` or calls one
verb; it computes nothing itself. pandas and matplotlib load with the first table or picture.
"""
