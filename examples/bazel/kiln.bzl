"""kiln_bake: one container of one model, a sandboxed action for each stage.

A stage is the command `kiln stage run`: it reads the pipeline, the model with what belongs to it, and the fragments (small cache
folders) of the stages before it, and leaves a fragment of its own, the same bytes on every run. Nothing else is shared, so Bazel
runs stages side by side, keeps their results, and hands them to remote execution as they are. The last action writes the
container from the fragments.
"""

def _action(ctx, out, arguments, fragments, what):
    args = ctx.actions.args()
    args.add_all(arguments)
    args.add_all(fragments, before_each = "--with", expand_directories = False)
    ctx.actions.run_shell(
        # Not the executable itself: Bazel would look for a name without a folder on PATH.
        command = "exec \"$PWD/%s\" \"$@\"" % ctx.file._kiln.path,
        tools = [ctx.file._kiln],
        arguments = [args],
        inputs = [ctx.file.pipeline, ctx.file.model] + ctx.files.data + fragments,
        outputs = [out],
        mnemonic = "Kiln",
        progress_message = "kiln %s, %s" % (ctx.file.model.short_path, what),
    )

def _kiln_bake_impl(ctx):
    # Paths on the command line are relative to the current folder, the execution root.
    common = ["--set", "asset.input=" + ctx.file.model.path, "--backend", "cpu"]
    made = {}
    for line in ctx.attr.stages:
        stage, _, before = line.partition(":")
        fragment = ctx.actions.declare_directory("%s.stages/%s" % (ctx.label.name, stage.replace("/", ".")))
        arguments = ["stage", "run", ctx.file.pipeline.path] + common
        arguments += ["--stage", stage, "--fragment", fragment.path]
        _action(ctx, fragment, arguments, [made[name] for name in before.split(" ") if name], stage)
        made[stage] = fragment
    out = ctx.actions.declare_file(ctx.label.name + ".kiln")
    arguments = ["build", ctx.file.pipeline.path] + common + ["--set", "asset.output=" + out.path]
    # A cache that nobody reads again, beside the container: it goes with the sandbox.
    arguments += ["--cache", out.path + ".cache"]
    _action(ctx, out, arguments, made.values(), "container")
    return [DefaultInfo(files = depset([out]))]

kiln_bake = rule(
    implementation = _kiln_bake_impl,
    attrs = {
        "pipeline": attr.label(allow_single_file = [".toml"], mandatory = True),
        "model": attr.label(allow_single_file = True, mandatory = True),
        "data": attr.label_list(allow_files = True, doc = "Buffers, pictures and parent pipelines that the model and pipeline name."),
        "stages": attr.string_list(mandatory = True, doc = "STAGE: ALL STAGES BEFORE IT, in the order of `kiln plan`."),
        "_kiln": attr.label(default = "//:kiln", allow_single_file = True),
    },
)
