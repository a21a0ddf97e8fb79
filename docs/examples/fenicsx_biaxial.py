"""The law in a FEniCSx program of one's own: a block between rough platens, on any number of ranks.

python fenicsx_biaxial.py            or            mpiexec -n 2 python fenicsx_biaxial.py
"""

import dolfinx_solver  # isort: skip  # of PyPI's package: tells the loader where MPI and PETSc are
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from petsc4py import PETSc

import granfabric as gf
from granfabric.fem.fenicsx.quadrature_law import QuadratureLaw

assert dolfinx_solver
pressure, steps, shortening = 100e3, 10, 5e-6

body = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (0.05, 0.1)], (12, 24))
space = fem.functionspace(body, ("Lagrange", 2, (2,)))
u, du, v = fem.Function(space), ufl.TrialFunction(space), ufl.TestFunction(space)

law = gf.ContactLaw([gf.Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
material = QuadratureLaw(law, u, degree=2, initial_stress=(-pressure, -pressure, 0.0))
# the pressure on the sides balances the initial stress there, so that only the difference enters
start = ufl.as_vector([-pressure, -pressure, 0.0])
unbalanced = fem.form(ufl.inner(start - material.stress, material.strain(v)) * material.dx)
tangent = fem.form(ufl.inner(material.tangent * material.strain(du), material.strain(v)) * material.dx)

body.topology.create_connectivity(1, 2)
ends = [mesh.locate_entities_boundary(body, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 0.1)]
moved = fem.Constant(body, default_scalar_type((0.0, 0.0)))
held = fem.Constant(body, default_scalar_type((0.0, 0.0)))
platens = [
    fem.dirichletbc(value, fem.locate_dofs_topological(space, 1, end), space) for value, end in zip((held, moved), ends)
]

matrix, right = petsc.create_matrix(tangent), petsc.create_vector(space)
solver = PETSc.KSP().create(body.comm)
solver.setType("preonly")
solver.getPC().setType("lu")
solver.getPC().setFactorSolverType("mumps")
correction = fem.Function(space)

for step in range(1, steps + 1):
    moved.value[1] = -shortening * step / steps
    for iteration in range(20):
        with right.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(right, unbalanced)
        matrix.zeroEntries()
        petsc.assemble_matrix(matrix, tangent, bcs=platens)
        matrix.assemble()
        # what platens still have to move is part of the correction
        petsc.apply_lifting(right, [tangent], bcs=[platens], x0=[u.x.petsc_vec])
        right.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        petsc.set_bc(right, platens, x0=u.x.petsc_vec)
        size = right.norm()
        if iteration == 0:
            first = size
        elif size <= 1e-8 * first:
            break
        solver.setOperators(matrix)
        solver.solve(right, correction.x.petsc_vec)
        correction.x.scatter_forward()
        u.x.array[:] += correction.x.array
        if not material.update():
            raise SystemExit("a point cannot follow: take smaller steps")
    else:
        raise SystemExit("no equilibrium within 20 iterations")
    material.commit()
    columns = law.description.columns("coordination")
    stress = material.stress.x.array.reshape(-1, 3)[: len(material.points)]
    means = material.mean(np.hstack([stress, material.state[:, columns]]))
    if body.comm.rank == 0:
        print(f"step {step:2}: {iteration} iterations, stress_yy {means[1] / 1e3:.4f} kPa, coordination {means[3]:.6f}")
