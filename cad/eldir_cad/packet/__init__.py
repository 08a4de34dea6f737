"""The build packet for the workshop: files, tables, drawings and PDFs.

Parts and plates come from `eldir_cad.geometry`.
"""
