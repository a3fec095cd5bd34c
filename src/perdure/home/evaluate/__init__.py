"""Evaluation: running episodes, writing logs, counting what stayed.

Contents:
    log         what is kept of an executed episode; each field is a column of the files
    files       logs as Parquet
    execute     runs task plans, open loop
    policies    which policy acts in which skill; release strategies by name
    protocol    episodes x training seeds x evaluation seeds, resumable
    outcomes    success and failure causes of one log; objects at rest that lie inside each other
    analysis    tables of many logs
    comparison  release strategies side by side: words and tables, from the tables of `analysis`
    figures     the same as figures
    page        the same as an offline page
"""
