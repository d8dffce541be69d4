"""Body, hand and face models as their makers publish them (docs/formats.md): each is read as a `TemplateModel`."""
