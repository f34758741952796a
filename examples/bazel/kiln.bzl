"""kiln_bake: one container of one model, as a sandboxed action.

One rule an asset, so that a changed picture reruns its own asset alone, on this machine or by remote execution. Bazel keeps the
results: kiln's own cache lives and dies with the sandbox.
"""

def _kiln_bake_impl(ctx):
    out = ctx.actions.declare_file(ctx.label.name + ".kiln")
    pipeline, model = ctx.file.pipeline, ctx.file.model
    ctx.actions.run_shell(
        inputs = [pipeline, model] + ctx.files.data,
        outputs = [out],
        tools = [ctx.file._kiln],
        # Paths on the command line are relative to the current folder, the execution root.
        command = " ".join([
            "'%s' build '%s'" % (ctx.file._kiln.path, pipeline.path),
            "--set 'asset.input=%s' --set 'asset.output=%s'" % (model.path, out.path),
            "--backend cpu --cache \"${TMPDIR:-/tmp}/kiln-$$\"",
        ]) + "; code=$?; rm -rf \"${TMPDIR:-/tmp}/kiln-$$\"; exit $code",
        mnemonic = "Kiln",
        progress_message = "kiln %s" % model.short_path,
    )
    return [DefaultInfo(files = depset([out]))]

kiln_bake = rule(
    implementation = _kiln_bake_impl,
    attrs = {
        "pipeline": attr.label(allow_single_file = [".toml"], mandatory = True),
        "model": attr.label(allow_single_file = True, mandatory = True),
        "data": attr.label_list(allow_files = True, doc = "Buffers, pictures and parent pipelines that the model and pipeline name."),
        "_kiln": attr.label(default = "//:kiln", allow_single_file = True),
    },
)
