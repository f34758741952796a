//! A level set to a container and back; GLB and PNG out.
