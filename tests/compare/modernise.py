"""Rewrites a scene of Mitsuba 0.x, so far as Mitsuba 3 goes on reading it.

What does not change the picture is taken away or replaced: integrators and samplers that are no more, the film's file format, and
properties that Mitsuba 3 does not know.
"""

import re
import xml.etree.ElementTree as xml

FILTERS = ("box", "tent", "gaussian")
# Properties that do not change the picture where Mitsuba 3 does not know them: of integrators, and of materials that are smooth or whose
# outer index is that of air.
WITHOUT_EFFECT = {"strictnormals", "exteta", "alpha", "distribution"}


def modernise(path):
    """Rewrites the file `path`."""
    tree = xml.parse(path)
    root = tree.getroot()
    for integrator in root.findall("integrator"):
        if integrator.get("type") not in ("path", "direct"):
            integrator.set("type", "path")
            keep_only(integrator, ("maxDepth", "max_depth", "hideEmitters", "hide_emitters"))
    for sampler in root.iter("sampler"):
        sampler.set("type", "independent")
        keep_only(sampler, ("sampleCount", "sample_count"))
    for film in root.iter("film"):
        film.set("type", "hdrfilm")
        keep_only(film, ("width", "height", "cropOffsetX", "cropOffsetY", "cropWidth", "cropHeight"), ("rfilter",))
        for rfilter in film.findall("rfilter"):
            if rfilter.get("type") not in FILTERS:
                film.remove(rfilter)
    for texture in root.iter("texture"):
        for child in list(texture):
            if child.get("name") in ("filterType", "filter_type") and child.get("value") in ("trilinear", "ewa"):
                texture.remove(child)
    tree.write(path)


def keep_only(element, names, tags=()):
    for child in list(element):
        if child.get("name") not in names and child.tag not in tags:
            element.remove(child)


def without_unknown(path, error):
    """Takes the properties without effect that Mitsuba's message calls unreferenced out of the file; whether there were any."""
    kind = re.search(r'unreferenced propert\w+ in \w+ plugin of type "(\w+)"', error)
    if not kind:
        return False
    # Mitsuba has turned the names of old files into snake case.
    names = {name.replace("_", "").lower() for name in re.findall(r'- \w+ "(\w+)"', error)} & WITHOUT_EFFECT
    tree = xml.parse(path)
    taken = False
    for element in tree.iter():
        if element.get("type") == kind[1]:
            for child in list(element):
                if (child.get("name") or "").replace("_", "").lower() in names:
                    element.remove(child)
                    taken = True
    tree.write(path)
    return taken
