"""Hungarian algorithm as a compiled loop; ``assignment.assign`` is the same by SciPy."""

from typing import no_type_check

import numpy as np

from pipeline.core.runtime.jit import inlined


@inlined
@no_type_check
def hungarian(num_rows, num_columns, room):
    """Assign rows to columns for the largest total ``room.gain``, by shortest augmenting paths.

    After Jonker and Volgenant (1987), with at most as many rows as columns. ``room.row_of`` gets the row of each
    column; rows and columns count from 1, and 0 means none.
    """
    gain, row_price, column_price, row_of = room.gain, room.row_price, room.column_price, room.row_of
    before, slack, done = room.before, room.slack, room.done
    row_price[: num_rows + 1] = 0.0
    column_price[: num_columns + 1] = 0.0
    row_of[: num_columns + 1] = 0
    for row in range(1, num_rows + 1):
        row_of[0] = row
        column = 0
        slack[: num_columns + 1] = np.inf
        done[: num_columns + 1] = False
        while row_of[column] != 0:
            done[column] = True
            at, nearest, step = row_of[column], 0, np.inf
            for j in range(1, num_columns + 1):
                if not done[j]:
                    cost = -gain[at - 1, j - 1] - row_price[at] - column_price[j]
                    if cost < slack[j]:
                        slack[j] = cost
                        before[j] = column
                    if slack[j] < step:
                        step = slack[j]
                        nearest = j
            for j in range(num_columns + 1):
                if done[j]:
                    row_price[row_of[j]] += step
                    column_price[j] -= step
                else:
                    slack[j] -= step
            column = nearest
        while column != 0:
            row_of[column] = row_of[before[column]]
            column = before[column]


@inlined
@no_type_check
def assign(num_rows, num_columns, room):
    """Match ``room.rows`` to ``room.columns`` for the largest total affinity; each pair has a positive affinity.

    If every row and every column is in at most one positive pair, the positive pairs are the solution.
    """
    affinity, rows, columns, match = room.affinity, room.rows, room.columns, room.match
    contested = False
    room.wanted[:num_columns] = 0
    for i in range(num_rows):
        wants = 0
        for j in range(num_columns):
            if affinity[rows[i], columns[j]] > 0:
                wants += 1
                room.wanted[j] += 1
                match[rows[i]] = columns[j]
                contested = contested or wants > 1 or room.wanted[j] > 1
    if not contested:
        return
    is_wide = num_rows <= num_columns
    for i in range(num_rows):
        match[rows[i]] = -1
        for j in range(num_columns):
            value = max(affinity[rows[i], columns[j]], 0.0)
            room.gain[i if is_wide else j, j if is_wide else i] = value
    hungarian(min(num_rows, num_columns), max(num_rows, num_columns), room)
    for place in range(max(num_rows, num_columns)):
        partner = room.row_of[place + 1] - 1
        if partner >= 0:
            i, j = (partner, place) if is_wide else (place, partner)
            if affinity[rows[i], columns[j]] > 0:
                match[rows[i]] = columns[j]
