//! Compiles the shim against the system's OpenImageIO, where the feature asks for it.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/shim.cpp");
    #[cfg(feature = "oiio")]
    build();
}

#[cfg(feature = "oiio")]
fn build() {
    let library = match pkg_config::Config::new().atleast_version("2.4").probe("OpenImageIO") {
        Ok(library) => library,
        Err(error) => {
            println!("cargo::error=the feature `oiio` needs OpenImageIO 2.4 or newer with its headers: {error}");
            return;
        }
    };
    let mut build = cc::Build::new();
    build.cpp(true).std("c++17").file("src/shim.cpp").includes(&library.include_paths);
    build.compile("kiln_oiio_shim");
    // The shim refers to the library, so it has to come before it.
    library.libs.iter().for_each(|name| println!("cargo::rustc-link-lib={name}"));
}
