"""Normal equations: products of coefficients, of what is left, and of what might explain it."""

from robofleet.core.kernels import image_kernel


@image_kernel
def sweep(matrix, many):  # type: ignore[no-untyped-def]
    """Solve for the first variables of a symmetric matrix, which is overwritten: the upper left block becomes minus its
    inverse, the lower left one the solution for each of the others, and the lower right one what is left of them."""
    for k in range(many):
        pivot = 1.0 / max(matrix[k, k], 1e-9)
        for i in range(len(matrix)):
            share = pivot * matrix[i, k]
            for j in range(len(matrix) if i != k else 0):
                if j != k:
                    matrix[i, j] -= share * matrix[k, j]
        for i in range(len(matrix)):
            matrix[i, k] *= pivot
            matrix[k, i] = matrix[i, k]
        matrix[k, k] = -pivot
