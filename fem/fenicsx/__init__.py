"""The second host: the same problems on FEniCSx (dolfinx, PETSc), spread over the ranks of MPI.

Rank 0 holds the problem, and what is written but for the fields, which each rank writes of its own cells; dolfinx
divides the mesh, assembles, and exchanges what ranks share; PETSc factorises and iterates. The load steps and Newton's
method are those of the own host, on vectors of which every rank holds its part.
"""
