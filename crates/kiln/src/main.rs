//! The command `kiln`.

fn main() -> std::process::ExitCode {
    kiln::command::main()
}
