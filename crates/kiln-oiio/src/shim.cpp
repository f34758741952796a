// A C face for the few calls that kiln makes of OpenImageIO (2.4 or newer). No exception leaves it; messages are cut to fit.

#include <cstdint>
#include <cstring>
#include <memory>
#include <sstream>
#include <string>

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <OpenImageIO/imageio.h>

using namespace OIIO;

namespace {

// The readers look at the bytes, since this is no name of a format.
const char* const NAME = "picture";

int fail(std::string text, char* message, size_t capacity)
{
    if (text.empty())
        text = "OpenImageIO gives no reason";
    size_t length = std::min(text.size(), capacity - 1);
    std::memcpy(message, text.data(), length);
    message[length] = 0;
    return 1;
}

// Colours as they are, not multiplied by alpha.
ImageSpec straight()
{
    ImageSpec config;
    config.attribute("oiio:UnassociatedAlpha", 1);
    return config;
}

// The picture in the memory that both readers cover. The first finds the format by the bytes, which only works without a
// configuration; the second, still at its start, is read with one.
std::unique_ptr<ImageInput> open_memory(Filesystem::IOMemReader& first, Filesystem::IOMemReader& second)
{
    std::string format;
    {
        auto probe = ImageInput::open(NAME, nullptr, &first);
        if (!probe)
            return nullptr;
        format = probe->format_name();
    }
    ImageSpec config = straight();
    Filesystem::IOProxy* proxy = &second;
    config.attribute("oiio:ioproxy", TypeDesc::PTR, &proxy);
    auto input = ImageInput::create(format, false, &config, &second);
    ImageSpec spec;
    if (!input || !input->open(NAME, spec, config))
        return nullptr;
    return input;
}

TypeDesc type_of(int kind)
{
    switch (kind) {
    case 0: return TypeDesc::UINT8;
    case 1: return TypeDesc::UINT16;
    case 2: return TypeDesc::HALF;
    default: return TypeDesc::FLOAT;
    }
}

}  // namespace

extern "C" {

int kiln_oiio_version() { return openimageio_version(); }

// Width, height and channels of the first picture in `bytes`.
int kiln_oiio_size(const uint8_t* bytes, size_t length, uint32_t out[3], char* message, size_t capacity)
{
    try {
        Filesystem::IOMemReader first(const_cast<uint8_t*>(bytes), length), second(const_cast<uint8_t*>(bytes), length);
        auto input = open_memory(first, second);
        if (!input)
            return fail(geterror(), message, capacity);
        const ImageSpec& spec = input->spec();
        if (spec.width <= 0 || spec.height <= 0 || spec.depth > 1 || spec.nchannels <= 0 || spec.deep)
            return fail("it is no flat picture", message, capacity);
        out[0] = uint32_t(spec.width);
        out[1] = uint32_t(spec.height);
        out[2] = uint32_t(spec.nchannels);
        return 0;
    } catch (const std::exception& error) {
        return fail(error.what(), message, capacity);
    } catch (...) {
        return fail("unknown failure", message, capacity);
    }
}

// All channels as floats into `out`, which holds `expected[0] * expected[1] * expected[2]` of them.
int kiln_oiio_read(const uint8_t* bytes, size_t length, const uint32_t expected[3], float* out, char* message,
                   size_t capacity)
{
    try {
        Filesystem::IOMemReader first(const_cast<uint8_t*>(bytes), length), second(const_cast<uint8_t*>(bytes), length);
        auto input = open_memory(first, second);
        if (!input)
            return fail(geterror(), message, capacity);
        const ImageSpec& spec = input->spec();
        if (uint32_t(spec.width) != expected[0] || uint32_t(spec.height) != expected[1]
            || uint32_t(spec.nchannels) != expected[2])
            return fail("its header changed", message, capacity);
        if (!input->read_image(0, 0, 0, spec.nchannels, TypeDesc::FLOAT, out))
            return fail(input->geterror(), message, capacity);
        return 0;
    } catch (const std::exception& error) {
        return fail(error.what(), message, capacity);
    } catch (...) {
        return fail("unknown failure", message, capacity);
    }
}

// `path`, tiled and mip-mapped, of channels that lie texel by texel in `texels`. `kind`: 0 bytes, 1 words, 2 halves, 3 floats.
// `format`: the writer's name, whatever the path ends in.
int kiln_oiio_make_texture(const char* path, const char* format, const void* texels, uint32_t width, uint32_t height,
                           uint32_t channels, int kind, char* message, size_t capacity)
{
    try {
        ImageSpec spec(int(width), int(height), int(channels), type_of(kind));
        ImageBuf source(spec, const_cast<void*>(texels));
        ImageSpec config;
        config.attribute("maketx:fileformatname", format);
        config.attribute("maketx:nomipmap", 0);
        config.attribute("maketx:filtername", "box");
        // No clock in a file.
        config.attribute("DateTime", "1970:01:01 00:00:00");
        config.tile_width = config.tile_height = 64;
        config.tile_depth = 1;
        config.format = type_of(kind);
        std::stringstream said;
        if (!ImageBufAlgo::make_texture(ImageBufAlgo::MakeTxTexture, source, path, config, &said))
            return fail(geterror() + said.str(), message, capacity);
        return 0;
    } catch (const std::exception& error) {
        return fail(error.what(), message, capacity);
    } catch (...) {
        return fail("unknown failure", message, capacity);
    }
}

// One level of a file as floats, to test what was written.
int kiln_oiio_read_level(const char* path, int level, uint32_t out_size[4], float* out, size_t count, char* message,
                         size_t capacity)
{
    try {
        const ImageSpec config = straight();
        auto input = ImageInput::open(path, &config);
        if (!input)
            return fail(geterror(), message, capacity);
        if (!input->seek_subimage(0, level))
            return fail("no such level", message, capacity);
        ImageSpec spec = input->spec(0, level);
        out_size[0] = uint32_t(spec.width);
        out_size[1] = uint32_t(spec.height);
        out_size[2] = uint32_t(spec.nchannels);
        out_size[3] = uint32_t(spec.tile_width);
        if (size_t(spec.width) * spec.height * spec.nchannels > count)
            return fail("too large", message, capacity);
        if (!input->read_image(0, level, 0, spec.nchannels, TypeDesc::FLOAT, out))
            return fail(input->geterror(), message, capacity);
        return 0;
    } catch (const std::exception& error) {
        return fail(error.what(), message, capacity);
    } catch (...) {
        return fail("unknown failure", message, capacity);
    }
}
}
