//! Every shader pass as a constant, with its hash and the path of its CPU twin.
