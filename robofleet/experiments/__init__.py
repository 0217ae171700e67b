"""The paper's experiments, one file each: a function from parameters to tables and figures, without drawing."""
