<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE TS>
<TS version="2.1" language="de" sourcelanguage="en">
  <context>
    <name>pcwlad_geo</name>
    <message>
      <source>Apply registration</source>
      <translation>Registrierung anwenden</translation>
    </message>
    <message>
      <source>Applies the correction of a finished registration to another band of its target, of any pixel size. The raster is warped once, with all its bands; nothing is matched.
&lt;b&gt;Registration&lt;/b&gt;: the folder that “Register raster” wrote as &lt;i&gt;Folder of all results&lt;/i&gt;. Use the batch mode for many bands.</source>
      <translation>Wendet die Korrektur einer fertigen Registrierung auf einen anderen Kanal ihres Ziels an, bei beliebiger Pixelgröße. Das Raster wird einmal entzerrt, mit allen Kanälen; es wird nichts neu zugeordnet.
&lt;b&gt;Registrierung&lt;/b&gt;: der Ordner, den „Raster registrieren“ als &lt;i&gt;Ordner aller Ergebnisse&lt;/i&gt; geschrieben hat. Für viele Kanäle gibt es den Stapelmodus.</translation>
    </message>
    <message>
      <source>Registration (folder of all results)</source>
      <translation>Registrierung (Ordner aller Ergebnisse)</translation>
    </message>
    <message>
      <source>Another band of the target</source>
      <translation>Anderer Kanal des Ziels</translation>
    </message>
    <message>
      <source>Registered raster</source>
      <translation>Registriertes Raster</translation>
    </message>
    <message>
      <source>Band-to-band QA</source>
      <translation>Passgenauigkeit von Kanälen prüfen</translation>
    </message>
    <message>
      <source>Measures how well the bands of several rasters, or of one, lie on each other: every pair, or each against one band. Nothing is corrected.
&lt;b&gt;Requirements&lt;/b&gt;: limits that every pair must meet, separated by semicolons, such as &lt;i&gt;CE90&amp;lt;=0.3px; closure&amp;lt;=0.05px&lt;/i&gt;. Statistics: mean, median, std, RMSE, LE90, CE90, CE95, closure; units: px, m. The output PASSED says whether all are met.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Bands of each, such as 2,4-6 (not set: all)</source>
      <translation>Kanäle jedes Rasters, etwa 2,4-6 (leer: alle)</translation>
    </message>
    <message>
      <source>Compare every band with this one only: the end of its name, such as B4</source>
      <translation>Jeden Kanal nur mit diesem vergleichen: Ende seines Namens, etwa B4</translation>
    </message>
    <message>
      <source>Requirements, separated by semicolons</source>
      <translation>Anforderungen, durch Semikolon getrennt</translation>
    </message>
    <message>
      <source>Rasters</source>
      <translation>Raster</translation>
    </message>
    <message>
      <source>Requirement of a mission</source>
      <translation>Anforderung einer Mission</translation>
    </message>
    <message>
      <source>Mask of all rasters (0 = excluded)</source>
      <translation>Maske aller Raster (0 = ausgeschlossen)</translation>
    </message>
    <message>
      <source>Report</source>
      <translation>Bericht</translation>
    </message>
    <message>
      <source>HTML files (*.html)</source>
      <translation>HTML-Dateien (*.html)</translation>
    </message>
    <message>
      <source>Table, a line a pair</source>
      <translation>Tabelle, eine Zeile je Paar</translation>
    </message>
    <message>
      <source>CSV files (*.csv)</source>
      <translation>CSV-Dateien (*.csv)</translation>
    </message>
    <message>
      <source>Folder of all results</source>
      <translation>Ordner aller Ergebnisse</translation>
    </message>
    <message>
      <source>Requirements met</source>
      <translation>Anforderungen erfüllt</translation>
    </message>
    <message>
      <source>Pairs</source>
      <translation>Paare</translation>
    </message>
    <message>
      <source>Pairs refused</source>
      <translation>Abgelehnte Paare</translation>
    </message>
    <message>
      <source>All requirements are met.</source>
      <translation>Alle Anforderungen sind erfüllt.</translation>
    </message>
    <message>
      <source>Not all requirements are met.</source>
      <translation>Nicht alle Anforderungen sind erfüllt.</translation>
    </message>
    <message>
      <source>Refused: {}</source>
      <translation>Abgelehnt: {}</translation>
    </message>
    <message>
      <source>Registration</source>
      <translation>Registrierung</translation>
    </message>
    <message>
      <source>Matching method</source>
      <translation>Verfahren der Zuordnung</translation>
    </message>
    <message>
      <source>Tie points wanted (0: all; not set: 1000 of a scene, all of a small image)</source>
      <translation>Gewünschte Verknüpfungspunkte (0: alle; leer: 1000 einer Szene, alle eines kleinen Bildes)</translation>
    </message>
    <message>
      <source>Search radius: largest displacement, pixels of the coarser raster (not set: automatic)</source>
      <translation>Suchradius: größte Verschiebung in Pixeln des gröberen Rasters (leer: automatisch)</translation>
    </message>
    <message>
      <source>More options of the command line, such as --window 129</source>
      <translation>Weitere Optionen der Kommandozeile, etwa --window 129</translation>
    </message>
    <message>
      <source>More options: a quotation mark is not closed. Close it, or leave it out.</source>
      <translation>Weitere Optionen: ein Anführungszeichen ist nicht geschlossen. Schließen Sie es, oder lassen Sie es weg.</translation>
    </message>
    <message>
      <source>{}: the engine writes GeoTIFF. Choose a file name that ends in .tif.</source>
      <translation>{}: Die Engine schreibt GeoTIFF. Wählen Sie einen Dateinamen, der auf .tif endet.</translation>
    </message>
    <message>
      <source>{}: {} is an input too. Choose another file.</source>
      <translation>{}: {} ist auch eine Eingabe. Wählen Sie eine andere Datei.</translation>
    </message>
    <message>
      <source>{}: {} is chosen for two outputs. Choose another file.</source>
      <translation>{}: {} ist für zwei Ausgaben gewählt. Wählen Sie eine andere Datei.</translation>
    </message>
    <message>
      <source>Engine: pcwlad-geo {}</source>
      <translation>Engine: pcwlad-geo {}</translation>
    </message>
    <message>
      <source>Engine</source>
      <translation>Engine</translation>
    </message>
    <message>
      <source>Check engine</source>
      <translation>Engine prüfen</translation>
    </message>
    <message>
      <source>Finds the engine that the other algorithms run, and says its version and whether it fits this plugin. It is looked for in Processing options (Providers, pcwlad-geo), in the environment variable PCWLAD_GEO_PYTHON, where “Install engine” puts it, and on PATH, in this order.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Version of the engine</source>
      <translation>Version der Engine</translation>
    </message>
    <message>
      <source>Fits this plugin</source>
      <translation>Passt zu dieser Erweiterung</translation>
    </message>
    <message>
      <source>They fit.</source>
      <translation>Sie passen zusammen.</translation>
    </message>
    <message>
      <source>Engine: {} ({})</source>
      <translation>Engine: {} ({})</translation>
    </message>
    <message>
      <source>Its version: {}; this plugin: {}</source>
      <translation>Ihre Version: {}; diese Erweiterung: {}</translation>
    </message>
    <message>
      <source>They do not fit: the plugin needs an engine {}.</source>
      <translation>Sie passen nicht zusammen: Die Erweiterung braucht eine Engine {}.</translation>
    </message>
    <message>
      <source>Install engine</source>
      <translation>Engine installieren</translation>
    </message>
    <message>
      <source>Makes a virtual environment in your QGIS profile and installs the engine there. QGIS and its own Python stay as they are.
Give the &lt;b&gt;wheel&lt;/b&gt; of pcwlad-geo (pcwlad_geo-….whl) or its &lt;b&gt;source folder&lt;/b&gt;. The libraries that it needs are downloaded by pip from the package index that is configured on this computer.
&lt;b&gt;Python&lt;/b&gt;: 3.10 or newer; found by itself in most cases. An engine installed earlier is replaced when the new one works.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Python 3.10 or newer (not set: found by itself)</source>
      <translation>Python 3.10 oder neuer (leer: wird selbst gefunden)</translation>
    </message>
    <message>
      <source>The installation failed (status {}) at: {}</source>
      <translation>Die Installation ist gescheitert (Status {}) bei: {}</translation>
    </message>
    <message>
      <source>No Python 3.10 or newer was found. Install one (python.org), and name it under “Python”.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Making the virtual environment</source>
      <translation>Virtuelle Umgebung wird angelegt</translation>
    </message>
    <message>
      <source>Downloading and installing</source>
      <translation>Herunterladen und installieren</translation>
    </message>
    <message>
      <source>The {} names another engine, {}, which goes before this one: clear it to use this one.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Wheel of pcwlad-geo</source>
      <translation>Wheel von pcwlad-geo</translation>
    </message>
    <message>
      <source>Or source folder of pcwlad-geo</source>
      <translation>Oder Quellordner von pcwlad-geo</translation>
    </message>
    <message>
      <source>All files (*)</source>
      <translation>Alle Dateien (*)</translation>
    </message>
    <message>
      <source>Give either a wheel or a source folder of pcwlad-geo.</source>
      <translation>Geben Sie entweder ein Wheel oder einen Quellordner von pcwlad-geo an.</translation>
    </message>
    <message>
      <source>Installed: pcwlad-geo {} in {}</source>
      <translation>Installiert: pcwlad-geo {} in {}</translation>
    </message>
    <message>
      <source>{} is no wheel of pcwlad-geo (pcwlad_geo-….whl).</source>
      <translation>{} ist kein Wheel von pcwlad-geo (pcwlad_geo-….whl).</translation>
    </message>
    <message>
      <source>{} is no source folder of pcwlad-geo: it has no pyproject.toml of that name.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Match only</source>
      <translation>Nur zuordnen</translation>
    </message>
    <message>
      <source>Finds tie points between two rasters of the same ground and measures how far the target is displaced. Nothing is fitted or warped.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Tie points&lt;/b&gt;: a layer with an arrow for the displacement of each point, exaggerated as its legend says. The arrow points from where the target's georeferencing places the ground to where the target shows it.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer.
&lt;b&gt;Points for the Georeferencer&lt;/b&gt;: loads by itself if it lies beside the target as &lt;i&gt;target.tif.points&lt;/i&gt;.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>DEM: what is added to its heights to count from the ellipsoid, where its CRS does not tell</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Mask of the reference (0 = excluded; or QA_PIXEL, SCL)</source>
      <translation>Maske der Referenz (0 = ausgeschlossen; oder QA_PIXEL, SCL)</translation>
    </message>
    <message>
      <source>Mask of the target (0 = excluded; or QA_PIXEL, SCL)</source>
      <translation>Maske des Ziels (0 = ausgeschlossen; oder QA_PIXEL, SCL)</translation>
    </message>
    <message>
      <source>DEM, for a target with RPCs</source>
      <translation>DGM, für ein Ziel mit RPC</translation>
    </message>
    <message>
      <source>Reference and target are the same raster and band. Choose another target.</source>
      <translation>Referenz und Ziel sind dasselbe Raster und derselbe Kanal. Wählen Sie ein anderes Ziel.</translation>
    </message>
    <message>
      <source>A requirement is not met, and nothing was corrected: {} (report: {})</source>
      <translation>Eine Anforderung ist nicht erfüllt, und nichts wurde korrigiert: {} (Bericht: {})</translation>
    </message>
    <message>
      <source>Reference (stays)</source>
      <translation>Referenz (bleibt)</translation>
    </message>
    <message>
      <source>Band of the reference</source>
      <translation>Kanal der Referenz</translation>
    </message>
    <message>
      <source>Target (moves)</source>
      <translation>Ziel (bewegt sich)</translation>
    </message>
    <message>
      <source>Band of the target</source>
      <translation>Kanal des Ziels</translation>
    </message>
    <message>
      <source>Tie points</source>
      <translation>Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>Points for the Georeferencer</source>
      <translation>Punkte für die Georeferenzierung</translation>
    </message>
    <message>
      <source>Georeferencer points (*.points)</source>
      <translation>Punkte der Georeferenzierung (*.points)</translation>
    </message>
    <message>
      <source>Median displacement, target pixels</source>
      <translation>Verschiebung (Median), Zielpixel</translation>
    </message>
    <message>
      <source>Median displacement to the right, target pixels</source>
      <translation>Verschiebung nach rechts (Median), Zielpixel</translation>
    </message>
    <message>
      <source>Median displacement down, target pixels</source>
      <translation>Verschiebung nach unten (Median), Zielpixel</translation>
    </message>
    <message>
      <source>Register raster</source>
      <translation>Raster registrieren</translation>
    </message>
    <message>
      <source>Registers a raster (the target) to another of the same ground (the reference) to a fraction of a pixel. The two may come from different bands, sensors or dates, and differ in pixel size, extent and CRS.
&lt;h3&gt;Results&lt;/h3&gt;&lt;b&gt;Registered raster&lt;/b&gt;: the target, warped once onto the reference's pixel alignment.
&lt;b&gt;Tie points&lt;/b&gt;: a layer with an arrow for the residual of each point, exaggerated as its legend says. The arrow points from where the correction expects the ground to where the target shows it.
&lt;b&gt;Report&lt;/b&gt;: opens in the Results Viewer; says how well it fits, where not, and what to do.
&lt;b&gt;Points for the Georeferencer&lt;/b&gt;: loads by itself if it lies beside the target as &lt;i&gt;target.tif.points&lt;/i&gt;.
&lt;b&gt;Folder of all results&lt;/b&gt;: needed for “Apply registration”.
RMSE and CE90 are those of check points, which the correction has not seen, in target pixels. The quality (good, fair or poor) is that of all the ground that both show.
&lt;h3&gt;If the pair is refused&lt;/h3&gt;A pair is refused if its points agree no better than those of unrelated images would, or if they agree but the correction does not hold: there is no raster then, and the message says why and what to try. A displacement of more than 12 pixels needs a larger search radius.
&lt;h3&gt;Requirements&lt;/h3&gt;Limits on the figures, such as &lt;i&gt;CE90&amp;lt;=0.5px; points&amp;gt;=100&lt;/i&gt;. Where one is not met, the algorithm fails and there is no raster, unless it is to be kept.</source>
      <translation>Registriert ein Raster (das Ziel) auf Bruchteile eines Pixels auf ein anderes desselben Bodens (die Referenz). Die beiden dürfen aus verschiedenen Kanälen, von verschiedenen Sensoren oder Tagen stammen und sich in Pixelgröße, Ausdehnung und KBS unterscheiden.
&lt;h3&gt;Ergebnisse&lt;/h3&gt;&lt;b&gt;Registriertes Raster&lt;/b&gt;: das Ziel, einmal auf die Pixelausrichtung der Referenz umgerechnet.
&lt;b&gt;Verknüpfungspunkte&lt;/b&gt;: ein Layer mit einem Pfeil für den Restfehler jedes Punktes, überhöht, wie die Legende sagt. Der Pfeil zeigt von dort, wo die Korrektur den Boden erwartet, dorthin, wo das Ziel ihn zeigt.
&lt;b&gt;Bericht&lt;/b&gt;: öffnet sich in der Ergebnisanzeige; sagt, wie gut es passt, wo nicht, und was zu tun ist.
&lt;b&gt;Punkte für die Georeferenzierung&lt;/b&gt;: werden von selbst geladen, wenn sie als &lt;i&gt;target.tif.points&lt;/i&gt; neben dem Ziel liegen.
&lt;b&gt;Ordner aller Ergebnisse&lt;/b&gt;: wird für „Registrierung anwenden“ gebraucht.
RMSE und CE90 sind die von Kontrollpunkten, die die Korrektur nicht gesehen hat, in Zielpixeln. Die Qualität (good: gut, fair: mäßig, poor: schlecht) ist die des ganzen Bodens, den beide zeigen.
&lt;h3&gt;Wenn das Paar abgelehnt wird&lt;/h3&gt;Ein Paar wird abgelehnt, wenn seine Punkte nicht besser übereinstimmen als die von Bildern, die nichts miteinander zu tun haben, oder wenn sie übereinstimmen, aber die Korrektur nicht trägt: dann gibt es kein Raster, und die Meldung sagt, warum und was zu versuchen ist. Eine Verschiebung um mehr als 12 Pixel braucht einen größeren Suchradius.
&lt;h3&gt;Anforderungen&lt;/h3&gt;Grenzen für die Kennzahlen, etwa &lt;i&gt;CE90&amp;lt;=0.5px; points&amp;gt;=100&lt;/i&gt;. Wird eine nicht erfüllt, scheitert der Algorithmus, und es gibt kein Raster, es sei denn, es soll behalten werden.</translation>
    </message>
    <message>
      <source>Keep the registered raster although a requirement is not met</source>
      <translation>Das registrierte Raster behalten, obwohl eine Anforderung nicht erfüllt ist</translation>
    </message>
    <message>
      <source>Correction model</source>
      <translation>Korrekturmodell</translation>
    </message>
    <message>
      <source>Quality: good, fair or poor</source>
      <translation>Qualität: good (gut), fair (mäßig) oder poor (schlecht)</translation>
    </message>
    <message>
      <source>RMSE at check points, target pixels</source>
      <translation>RMSE an Kontrollpunkten, Zielpixel</translation>
    </message>
    <message>
      <source>CE90 at check points, target pixels</source>
      <translation>CE90 an Kontrollpunkten, Zielpixel</translation>
    </message>
    <message>
      <source>RMSE at check points, metres</source>
      <translation>RMSE an Kontrollpunkten, Meter</translation>
    </message>
    <message>
      <source>CE90 at check points, metres</source>
      <translation>CE90 an Kontrollpunkten, Meter</translation>
    </message>
    <message>
      <source>No pcwlad-geo engine was found. Run the algorithm “Install engine”, or this command in a terminal, with the wheel or the source folder of pcwlad-geo at its end:
{}
An engine that is somewhere else: name it in Processing options, Providers, pcwlad-geo.</source>
      <translation>Es wurde keine Engine pcwlad-geo gefunden. Starten Sie den Algorithmus „Engine installieren“, oder in einem Terminal diesen Befehl mit dem Wheel oder dem Quellordner von pcwlad-geo am Ende:
{}
Eine Engine an anderer Stelle: in den Verarbeitungsoptionen unter Datenanbieter, pcwlad-geo eintragen.</translation>
    </message>
    <message>
      <source>Processing option</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>{} ({}) is no pcwlad-geo engine; it says: {}</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The engine {} has version {}, this plugin is {} and needs an engine {}. Install that one (algorithm “Install engine”), or the plugin that belongs to the engine.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>installed by the plugin</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The engine {} that the {} names does not exist. Correct it, or clear it.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The engine {} does not start: {}</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Quality: {}; 90 % of the common ground is expected to lie within {:.2f} px</source>
      <translation>Qualität: {}; 90 % des gemeinsamen Bodens liegen voraussichtlich innerhalb von {:.2f} px</translation>
    </message>
    <message>
      <source>Median displacement of the target: {:+.3f} px to the right, {:+.3f} px down</source>
      <translation>Mittlere Verschiebung des Ziels (Median): {:+.3f} px nach rechts, {:+.3f} px nach unten</translation>
    </message>
    <message>
      <source>good</source>
      <translation>gut</translation>
    </message>
    <message>
      <source>fair</source>
      <translation>mäßig</translation>
    </message>
    <message>
      <source>poor</source>
      <translation>schlecht</translation>
    </message>
    <message>
      <source>Tie points: {:.0f}</source>
      <translation>Verknüpfungspunkte: {:.0f}</translation>
    </message>
    <message>
      <source> (RMSE {RMSE_M:.2f} m, CE90 {CE90_M:.2f} m)</source>
      <translation> (RMSE {RMSE_M:.2f} m, CE90 {CE90_M:.2f} m)</translation>
    </message>
    <message>
      <source>What is left: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px</source>
      <translation>Es bleiben: RMSE {RMSE:.3f} px, CE90 {CE90:.3f} px</translation>
    </message>
    <message>
      <source>Reading</source>
      <translation>Lesen</translation>
    </message>
    <message>
      <source>Rough alignment</source>
      <translation>Grobe Ausrichtung</translation>
    </message>
    <message>
      <source>Matching</source>
      <translation>Zuordnen</translation>
    </message>
    <message>
      <source>Fitting the correction</source>
      <translation>Korrektur anpassen</translation>
    </message>
    <message>
      <source>Writing</source>
      <translation>Schreiben</translation>
    </message>
    <message>
      <source>Warping</source>
      <translation>Entzerren</translation>
    </message>
    <message>
      <source>Its last lines:</source>
      <translation>Ihre letzten Zeilen:</translation>
    </message>
    <message>
      <source>The pair was refused, and nothing was corrected: {}</source>
      <translation>Das Paar wurde abgelehnt und nichts korrigiert: {}</translation>
    </message>
    <message>
      <source>The engine ended with status {} and without a result.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The engine does not start: {}</source>
      <translation>Die Engine startet nicht: {}</translation>
    </message>
    <message>
      <source>pcwlad-geo: sub-pixel registration of rasters</source>
      <translation>pcwlad-geo: Raster auf Bruchteile eines Pixels registrieren</translation>
    </message>
    <message>
      <source>Engine: a Python with pcwlad-geo in it, or the program pcwlad-geo</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The layer “{}” has the CRS {} in QGIS, but its file says {}. The engine reads the file: if QGIS is right, run “Assign projection” on it first.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The layer “{}” is no raster file (it comes from the provider “{}”). Save it first: right-click the layer, Export, Save As…, and use the file.</source>
      <translation>Der Layer „{}“ ist keine Rasterdatei (er kommt vom Datenanbieter „{}“). Speichern Sie ihn zuerst: Rechtsklick auf den Layer, Export, Speichern als…, und nehmen Sie die Datei.</translation>
    </message>
    <message>
      <source>The layer “{}” is opened with options ({}) that the engine cannot use. Save it as a file first.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The layer “{}” shows a part of its file (filter {}). Remove the filter, or save it as a file.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>none</source>
      <translation>keines</translation>
    </message>
    <message>
      <source>The layer “{}” is a virtual raster without a file. Save it as a file first.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The layer “{}” is in memory only. Save it as a file first.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>Search radius</source>
      <translation>Suchradius</translation>
    </message>
    <message>
      <source>Tie points wanted</source>
      <translation>Gewünschte Verknüpfungspunkte</translation>
    </message>
    <message>
      <source>DEM: what is added to its heights</source>
      <translation>DGM: was zu seinen Höhen addiert wird</translation>
    </message>
    <message>
      <source>Mask of the reference</source>
      <translation>Maske der Referenz</translation>
    </message>
    <message>
      <source>Mask of the target</source>
      <translation>Maske des Ziels</translation>
    </message>
    <message>
      <source>(Options that begin with -- go into the advanced parameter “More options”.)</source>
      <translation>(Optionen, die mit -- beginnen, gehören in den erweiterten Parameter „Weitere Optionen“.)</translation>
    </message>
    <message>
      <source>fit</source>
      <translation>Anpassung</translation>
    </message>
    <message>
      <source>matched</source>
      <translation>zugeordnet</translation>
    </message>
    <message>
      <source>check</source>
      <translation>Kontrolle</translation>
    </message>
    <message>
      <source>unused</source>
      <translation>nicht benutzt</translation>
    </message>
    <message>
      <source>rejected</source>
      <translation>verworfen</translation>
    </message>
    <message>
      <source>{}: residual × {:g}</source>
      <translation>{}: Restfehler × {:g}</translation>
    </message>
    <message>
      <source>{}: displacement × {:g}</source>
      <translation>{}: Verschiebung × {:g}</translation>
    </message>
    <message>
      <source>There are too few tie points for arrows along the axes of the map.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The tie points in {} cannot be read.</source>
      <translation type="unfinished" />
    </message>
    <message>
      <source>The tie points cannot be written: {}</source>
      <translation type="unfinished" />
    </message>
  </context>
</TS>
